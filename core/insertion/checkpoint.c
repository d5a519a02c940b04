#include "insertion/checkpoint.h"

void checkpoint_save(const tick_context *tick, pass_checkpoint *saved) {
    const insertion_state *state = tick->state;
    const insertion_workspace *w = tick->scratch;
    saved->needle = state->needle;
    saved->base_shift = state->base_shift;
    saved->tip = state->tip;
    saved->knot = w->problem.knot;
    for (int i = 0; i < w->points.count; i++) {
        const contact_point *p = &w->points.list[i];
        if (p->kind == POINT_GUIDE) saved->faces[i] = state->guides[p->guide].faces[p->face];
        if (p->kind != POINT_TISSUE) continue;
        saved->contacts[i].force = state->contacts[p->handle].force;
        saved->contacts[i].shaft = state->contacts[p->handle].shaft;
    }
}

void checkpoint_restore(const tick_context *tick, const pass_checkpoint *saved) {
    insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    state->needle = saved->needle;
    state->base_shift = saved->base_shift;
    state->tip = saved->tip;
    w->problem.knot = saved->knot;
    for (int i = 0; i < w->points.count; i++) {
        const contact_point *p = &w->points.list[i];
        if (p->kind == POINT_GUIDE) state->guides[p->guide].faces[p->face] = saved->faces[i];
        if (p->kind != POINT_TISSUE) continue;
        state->contacts[p->handle].force = saved->contacts[i].force;
        state->contacts[p->handle].shaft = saved->contacts[i].shaft;
    }
}
