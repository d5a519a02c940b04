#include "insertion/step/checkpoint.h"

void checkpoint_save(const insertion_state *state, const contact_points *points, const contact_problem *problem, pass_checkpoint *saved) {
    saved->needle = state->needle;
    saved->base_shift = state->base_shift;
    saved->tip = state->tip;
    saved->knot = problem->knot;
    for (int i = 0; i < points->count; i++) {
        const contact_point *p = &points->list[i];
        if (p->kind == POINT_GUIDE) saved->faces[i] = state->guides[p->guide].faces[p->face];
        if (p->kind != POINT_TISSUE) continue;
        saved->contacts[i].force = state->contacts[p->handle].force;
        saved->contacts[i].shaft = state->contacts[p->handle].shaft;
    }
}

void checkpoint_restore(insertion_state *state, const contact_points *points, contact_problem *problem, const pass_checkpoint *saved) {
    state->needle = saved->needle;
    state->base_shift = saved->base_shift;
    state->tip = saved->tip;
    problem->knot = saved->knot;
    for (int i = 0; i < points->count; i++) {
        const contact_point *p = &points->list[i];
        if (p->kind == POINT_GUIDE) state->guides[p->guide].faces[p->face] = saved->faces[i];
        if (p->kind != POINT_TISSUE) continue;
        state->contacts[p->handle].force = saved->contacts[i].force;
        state->contacts[p->handle].shaft = saved->contacts[i].shaft;
    }
}
