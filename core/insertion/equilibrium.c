#include "insertion/equilibrium.h"

#include <string.h>

#include "insertion/checkpoint.h"
#include "insertion/continuation.h"
#include "insertion/creep.h"
#include "insertion/resistance_ahead.h"
#include "insertion/roll.h"
#include "insertion/tip_damper.h"

static const double BITE_TIME = 20e-3; /* s: lag with which the surface's hold follows the force along the needle; without it, the two would alternate. Chosen */

/* What is ahead of the tip, from the needle's shape at which the passes start. */
static void begin(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    w->response.drag = w->continuation.left = 0.0;
    passes_begin(tick);
    if (w->points.tip) resistance_ahead_find(tick);
    profile_end_stage(&w->profile, INSERTION_TISSUE);
}

void equilibrium_linearise(const tick_context *tick, bool loaded) {
    begin(tick);
    if (!loaded) memset(tick->scratch->response.load, 0, sizeof tick->scratch->response.load);
    tick->scratch->damper.relaxed = 1.0; /* at rest, nothing springs back */
    passes_linearise(tick, true);
}

static void go_back(const tick_context *tick) {
    checkpoint_restore(tick, &tick->scratch->start);
    passes_begin(tick);
}

/* The passes, as nearly always, else their fallback. A needle that goes on as in the last step often needs only one pass: its guessed shape is a better
   start, and nothing else. A misleading guess costs a pass or two; starting again from the last shape would cost more (18 000 steps of a hand that changes
   its mind every 13 ms, in guides and in stiffening tissue: 43 361 passes, instead of 56 572; without any guess 66 336). */
static pass_result find(const tick_context *tick) {
    insertion_state *state = tick->state;
    const needle_model *needle = tick->model->needle;
    insertion_workspace *w = tick->scratch;
    needle_go_on(needle, &state->motion, tick->dt, &state->needle);
    begin(tick);
    state->motion.time = 0.0;
    if (state->moving_on) return continuation_follow(tick);
    pass_result r = passes_run(tick, tick->model->settings.max_passes);
    if (!r.found || r.diverging || r.saddle || r.leapt) {
        go_back(tick);
        return continuation_follow(tick);
    }
    if (r.converged) needle_motion_of(needle, &w->start.needle, &state->needle, tick->dt, &state->motion);
    return r;
}

static void filter_push(needle_tip *tip, const needle_point *p, double dt) {
    double pressing = fmax(v3_dot(tip->solved.force, needle_along(p)), 0.0);
    tip->filtered_push += (pressing - tip->filtered_push) * -expm1(-dt / BITE_TIME);
}

/* What follows from the forces: the tip's dent and track, the shaft's roll, what the tissue remembers. */
static void conclude(const tick_context *tick, pass_result r) {
    needle_tip *tip = &tick->state->tip;
    const insertion_workspace *w = tick->scratch;
    const contact_point *last = &w->points.list[w->points.count - 1];
    if (!r.converged) tick->output->events |= EVENT_INEXACT;
    if (w->points.tip && r.found) tip->track = resistance_ahead_track(tick);
    if (w->points.tip) tip->dent.rest = last->target;
    if (w->points.tip) spring_back(tick);
    roll_solve(tick);
    creep_remember(tick);
    if (w->points.tip) filter_push(tip, &last->at, tick->dt);
}

void equilibrium_find(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    w->problem.knot = 0;
    checkpoint_save(tick, &w->start);
    conclude(tick, find(tick));
}

void equilibrium_forget(insertion_state *state) {
    state->base_shift = v3(0, 0, 0);
    state->motion.time = 0.0;
    state->moving_on = false;
}
