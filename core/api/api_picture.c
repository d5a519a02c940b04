/* Implements trocar/picture.h. */
#include <stdlib.h>
#include <string.h>

#include "api/ticking.h"
#include "api/view.h"
#include "base/flush_denormals.h"
#include "snapshot/free_displacement.h"
#include "tissue/blas.h"

trocar_status trocar_picture_create(trocar_model *model, trocar_picture **created, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    *created = NULL;
    if (model->mesh_only) return fail(why, TROCAR_BAD_INPUT, "this model has only a mesh: create it without mesh_only");
    trocar_status status = blas_make_room(2, why); /* the picture's thread may compute displacements while the worker runs */
    if (status != TROCAR_OK) return status;
    trocar_picture *p = calloc(1, sizeof *p);
    size_t states = (size_t)model->parts.config.needle_count * sizeof *p->states;
    if (p) p->states = malloc(states);
    status = p && p->states ? inverse_create_mixed(model->parts.inverse, &p->mixed, why) : fail(why, TROCAR_NO_MEMORY, "no memory for a picture");
    if (status != TROCAR_OK) {
        if (p) free(p->states);
        free(p);
        return status;
    }
    memset(p->states, 0, states); /* touch the pages now, so that the ticking thread does not fault later */
    p->model = model_share(model);
    p->from = model_share(model);
    p->to = model_share(model);
    p->view = (trocar_view){.model = model, .picture = p, .scratch = &p->scratch};
    floating_mode before = flush_denormals();
    for (int i = 0; i < model->parts.config.needle_count; i++) {
        p->bases[i] = (pose){.orientation = {1, 0, 0, 0}};
        insertion_reset(&model->parts.insertion, p->bases[i], &p->states[i]);
    }
    restore_floating_mode(before);
    *created = p;
    return TROCAR_OK;
}

void trocar_picture_free(trocar_picture *picture) {
    if (!picture) return;
    refined_mesh_free(&picture->refined);
    free(picture->states);
    free(picture->scratch);
    free(picture->force);
    free(picture->displacement);
    inverse_free(picture->mixed);
    trocar_model_free(picture->from);
    trocar_model_free(picture->to);
    trocar_model_free(picture->model);
    model_free_retired();
    free(picture);
}

static void use_models(trocar_picture *picture, trocar_model *from, trocar_model *to, double weight) {
    model_share(from);
    model_share(to);
    model_release(picture->from);
    model_release(picture->to);
    picture->from = from;
    picture->to = to;
    picture->weight = weight;
    inverse_mix(picture->mixed, from->parts.inverse, to->parts.inverse, weight);
}

enum { RESTING_AT_ONCE = 2 }; /* copy at most this many changed resting needles per call, to bound its time */

void trocar_sim_take_picture(const trocar_sim *sim, trocar_picture *picture) {
    int room = RESTING_AT_ONCE, first = picture->next_resting;
    for (int k = 0; k < sim->needle_count; k++) {
        int i = (first + k) % sim->needle_count;
        uint64_t stamp;
        const insertion_state *state = state_of_needle(sim, i, &stamp);
        bool rests = state != &sim->needles[i].state;
        if (stamp == picture->stamps[i] || (rests && room == 0)) continue;
        memcpy(&picture->states[i], state, sizeof *state);
        picture->bases[i] = base_of_needle(sim, i);
        picture->stamps[i] = stamp;
        if (rests) room--, picture->next_resting = (i + 1) % sim->needle_count;
    }
    picture->time = sim->rounds.time;
    const elasticity *e = &sim->elasticity;
    use_models(picture, e->from.model, e->to.model, elasticity_weight(e));
    seeds_copy(&sim->seeds, sim->needle_count, &picture->seeds);
    const shown_probe *probe = shown_probe_of(sim);
    if (probe && probe->stamp != picture->probe.stamp) picture->probe = *probe;
}

void trocar_picture_copy(const trocar_picture *from, trocar_picture *to) {
    for (int i = 0; i < from->model->parts.config.needle_count; i++) {
        if (from->stamps[i] == to->stamps[i]) continue;
        to->states[i] = from->states[i];
        to->bases[i] = from->bases[i];
        to->stamps[i] = from->stamps[i];
    }
    to->time = from->time;
    use_models(to, from->from, from->to, from->weight);
    seeds_copy(&from->seeds, from->model->parts.config.needle_count, &to->seeds);
    if (from->probe.stamp != to->probe.stamp) to->probe = from->probe;
}

static void states_of(const trocar_picture *p, const insertion_state *states[MAX_NEEDLES]) {
    for (int i = 0; i < p->model->parts.config.needle_count; i++) states[i] = &p->states[i];
}

trocar_status trocar_picture_refined_mesh(trocar_picture *p, trocar_refined_mesh *mesh, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    const model_parts *parts = &p->model->parts;
    size_t nominal = (size_t)parts->mesh.node_count, room = nominal + MAX_CONTACTS;
    refinement refined;
    refined_mesh_free(&p->refined);
    if (!p->force) p->force = malloc(room * sizeof *p->force);
    if (!p->displacement) p->displacement = malloc(room * sizeof *p->displacement);
    if (!p->force || !p->displacement) return fail(why, TROCAR_NO_MEMORY, "no memory for a refined mesh of %zu nodes", room);
    const insertion_state *states[MAX_NEEDLES];
    states_of(p, states);
    trocar_status status = field_of(p->model, p->mixed, states, &p->probe, &p->scratch, p->displacement, p->displacement + nominal, why);
    if (status != TROCAR_OK) return status;
    memset(p->force, 0, room * sizeof *p->force);
    insertion_refinement(&p->states[0], &refined);
    insertion_forces(&parts->insertion, &p->states[0], p->force, p->force + nominal);
    spread_others(p->model, states, &p->probe, p->force);
    status = refined_mesh_create(&parts->mesh, &refined, &p->refined, why);
    if (status != TROCAR_OK) return status;
    const refined_mesh *r = &p->refined;
    vec3 damping = v3(0, 0, 0);
    for (int i = 0; i < p->model->parts.config.needle_count; i++) damping = v3_add(damping, p->states[i].tip.dent.damping);
    *mesh = (trocar_refined_mesh){.node_count = r->node_count, .tet_count = r->tet_count, .nodes = &r->nodes[0].x, .tets = r->tets[0],
                                  .parents = r->parent, .displacements = &p->displacement[0].x, .forces = &p->force[0].x,
                                  .damping = {damping.x, damping.y, damping.z}};
    return TROCAR_OK;
}
