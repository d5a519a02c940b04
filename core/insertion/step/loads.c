#include "insertion/step/loads.h"

#include <string.h>

#include "insertion/laws/creep.h"

void insertion_refinement(const insertion_state *state, refinement *out) {
    refinement_compact(&state->refined, contacts_active(state), out);
}

void insertion_forces(const insertion_model *model, const insertion_state *state, vec3 *nominal, vec3 *added) {
    const needle_tip *tip = &state->tip;
    for (int k = 0; contact_is_active(state, k); k++)
        added[k] = v3_add(state->contacts[state->refined.order[k]].force, creep_load(model, &state->memory, k));
    for (int i = 0; i < state->memory.residual.count; i++)
        for (int c = 0; c < 4; c++) {
            const residual_load *residual = &state->memory.residual.loads[i];
            vec3 *corner = &nominal[model->mesh->tets[residual->tet][c]];
            *corner = v3_axpy(residual->weights[c], creep_residual_load(model, residual), *corner);
        }
    if (tip->place.phase != TIP_INSIDE || tip->known.tet < 0) return;
    for (int c = 0; c < 4; c++) {
        vec3 *corner = &nominal[model->mesh->tets[tip->known.tet][c]];
        *corner = v3_axpy(tip->known.weights[c], v3_add(tip_load(tip), creep_tip_load(model, &state->memory)), *corner);
    }
}

void insertion_add_residual_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads) {
    for (int i = 0; i < state->memory.residual.count && loads->count < MAX_LOADS; i++) {
        const residual_load *residual = &state->memory.residual.loads[i];
        tissue_load *load = &loads->loads[loads->count++];
        *load = (tissue_load){.tet = residual->tet, .force = creep_residual_load(model, residual), .residual = true, .shaft = residual->shaft};
        memcpy(load->weights, residual->weights, sizeof load->weights);
    }
}

void insertion_place_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads) {
    const needle_tip *tip = &state->tip;
    bool inside = tip->place.phase == TIP_INSIDE && tip->known.tet >= 0;
    double border = 0.0;
    loads->count = 0;
    for (int k = 0; contact_is_active(state, k); k++) {
        int slot = state->refined.order[k];
        const added_node *node = &state->refined.nodes[slot];
        tissue_load *load = &loads->loads[loads->count++];
        *load = (tissue_load){.tet = node->tet, .shaft = shaft_piece_of_contact(state, slot, shaft_next_share(state, k, inside, &border))};
        mesh_barycentric(model->mesh, node->tet, node->position, load->weights);
    }
    if (!inside) return;
    tissue_load *load = &loads->loads[loads->count];
    *load = (tissue_load){.tet = tip->known.tet, .shaft = shaft_piece_of_tip(state, shaft_next_share(state, loads->count, true, &border))};
    memcpy(load->weights, tip->known.weights, sizeof load->weights);
    loads->count++;
}

void insertion_add_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads) {
    insertion_place_loads(model, state, loads);
    int contacts = contacts_active(state);
    for (int k = 0; k < contacts; k++)
        loads->loads[k].force = v3_add(state->contacts[state->refined.order[k]].force, creep_load(model, &state->memory, k));
    if (loads->count > contacts) loads->loads[contacts].force = v3_add(tip_load(&state->tip), creep_tip_load(model, &state->memory));
    insertion_add_residual_loads(model, state, loads);
}
