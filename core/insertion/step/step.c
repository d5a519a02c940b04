#include "insertion/step/step.h"

#include "insertion/contact/roll.h"
#include "insertion/contact/tissue_stage.h"
#include "insertion/laws/creep.h"
#include "insertion/step/equilibrium.h"
#include "insertion/step/hand.h"
#include "insertion/tip/known_tissue.h"
#include "insertion/tip/path_stage.h"
#include "insertion/tip/tip.h"
#include "insertion/tip/track_gradient.h"

/* Sums the forces of all points into the wrench on the base. */
static void find_wrench(const insertion_state *state, const contact_points *points, tick_output *output) {
    output->force = output->torque = v3(0, 0, 0);
    for (int i = 0; i < points->count; i++) {
        const contact_point *point = &points->list[i];
        vec3 on_needle = v3_scale(-1.0, point_force(state, point));
        vec3 lever = v3_sub(point->at.position, state->needle.base.position);
        output->force = v3_add(output->force, on_needle);
        output->torque = v3_add(output->torque, v3_cross(lever, on_needle));
    }
    double torque = roll_torque(state, points);
    if (torque != 0.0) output->torque = v3_axpy(-torque, q_axis(state->needle.base.orientation), output->torque);
    output->depth = state->tip.place.phase == TIP_FREE ? 0.0 : state->tip.place.depth;
    output->contacts = contacts_active(state);
}

void step(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output) {
    creep_begin(tick, state, &w->creep);                             /* the tissue's memory of past forces decays over dt */
    hand_slide_shaft(tick, state);                                   /* hand: the shaft slides by the slips of the last solve */
    vec3 gradient = track_gradient(tick, state, &w->creep);
    hand_move(tick, state, &w->hand);                                /* hand: the base moves to its new pose */
    path_follow(tick, state, &w->hand, &w->path, &w->creep, output, gradient); /* path: tip, membranes, old tracks, guides */
    w->points.added = accept_snapshot(tick, state, output);          /* tissue: lists the contact points and finds the tissue's compliance there */
    bool touches = tissue_find(tick, state, &w->points, &w->tissue, &w->creep, &w->stiffening, &w->damper, output);
    if (touches) equilibrium_find(tick, state, w, output);           /* Newton passes: needle, problem, solve, advance */
    else equilibrium_forget(state);
    tip_puncture(tick, state, &w->creep, output);                    /* conclude: punctures a membrane if its strength was exceeded */
    find_wrench(state, &w->points, output);                          /* output; the tick sends requests to the worker at its end */
}
