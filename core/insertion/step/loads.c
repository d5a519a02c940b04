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
        *load = (tissue_load){.tet = residual->tet, .force = creep_residual_load(model, residual)};
        memcpy(load->weights, residual->weights, sizeof load->weights);
    }
}

/* Returns the piece of shaft that the contact in `slot` represents, or the tip if `slot` is NO_SLOT. */
enum { NO_SLOT = -1 };
static shaft_piece piece_of(const insertion_state *state, int slot, shaft_share share) {
    const needle_tip *tip = &state->tip;
    if (slot != NO_SLOT) {
        const shaft_contact *contact = &state->contacts[slot];
        const added_node *node = &state->refined.nodes[slot];
        line_in_tet line = v3_norm(node->line.direction) > 0.0 ? node->line : (line_in_tet){node->tet, node->position, contact->direction};
        return (shaft_piece){share.from, share.to, contact->depth, v3_sub(contact->track, contact->beside), contact->direction, line};
    }
    line_in_tet line = {tip->place.tet, tip->place.nominal, tip->place.direction};
    for (int i = 0; i < state->request.piece_count; i++) /* uses the same line for the tip's entire chord through an element */
        if (state->request.pieces[i].tet == tip->place.tet) line = state->request.pieces[i];
    return (shaft_piece){share.from, share.to, tip->place.depth, tip->place.nominal, tip->place.direction, line};
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
        *load = (tissue_load){.tet = node->tet, .shaft = piece_of(state, slot, shaft_next_share(state, k, inside, &border))};
        mesh_barycentric(model->mesh, node->tet, node->position, load->weights);
    }
    if (!inside) return;
    tissue_load *load = &loads->loads[loads->count];
    *load = (tissue_load){.tet = tip->known.tet, .shaft = piece_of(state, NO_SLOT, shaft_next_share(state, loads->count, true, &border))};
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
