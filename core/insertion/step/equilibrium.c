#include "insertion/step/equilibrium.h"

#include <string.h>

#include "insertion/contact/contact_assembly.h"
#include "insertion/contact/resistance_ahead.h"
#include "insertion/contact/roll.h"
#include "insertion/contact/tip_damper.h"
#include "insertion/laws/creep.h"
#include "insertion/laws/stiffening.h"
#include "insertion/step/checkpoint.h"
#include "insertion/step/continuation.h"

static const double BITE_TIME = 20e-3; /* s: time constant with which the surface's lateral support follows the force along the needle. Without this lag, the
                                          two would oscillate. Chosen by judgement */

/* Prepares the passes: locates the points for the needle's starting shape and lists the resistance ahead of the tip. */
static void begin(const tick_input *tick, const insertion_state *state, insertion_workspace *w) {
    w->response.drag = w->continuation.kept_open = 0.0;
    passes_begin(tick, state, w);
    if (w->points.tip) resistance_ahead_find(tick, state, &w->hand, &w->path, &w->points, &w->ahead);
    profile_end_part(&w->profile, TIMED_TISSUE);
}

void equilibrium_linearise(const tick_input *tick, insertion_state *state, insertion_workspace *w, bool loaded) {
    begin(tick, state, w);
    if (!loaded) memset(w->response.load, 0, sizeof w->response.load);
    w->damper.relaxed = 1.0; /* the damper does not act in a static linearisation */
    passes_linearise(tick, state, w, true);
}

void equilibrium_linearise_laws(const tick_input *tick, const insertion_state *state, insertion_workspace *w) {
    stiffening_linearise(tick, state, &w->points, &w->tissue, &w->creep, &w->stiffening, &w->damper, true);
    assemble_compliance(tick, state, w);
}

static void filter_push(needle_tip *tip, const needle_point *p, double dt) {
    double push = fmax(v3_dot(tip->solved.force, needle_along(p)), 0.0);
    tip->filtered_push += (push - tip->filtered_push) * -expm1(-dt / BITE_TIME);
}

/* Updates what depends on the final forces: the tip's dent and track, the shaft's roll and the tissue's memory. */
static void conclude(const tick_input *tick, insertion_state *state, const insertion_workspace *w, tick_output *output, pass_result r) {
    needle_tip *tip = &state->tip;
    const contact_point *last = &w->points.list[w->points.count - 1];
    if (!r.converged) output->events |= EVENT_INEXACT;
    if (w->points.tip && r.found) tip->track = resistance_ahead_track(&w->ahead, &w->problem);
    if (w->points.tip) tip->dent.rest = last->target;
    if (w->points.tip) damper_conclude(tick, state, w);
    roll_solve(tick, state, &w->points, &w->creep);
    creep_remember(tick, state, &w->points, &w->tissue, &w->creep);
    if (w->points.tip) filter_push(tip, &last->at, tick->dt);
    if (!r.found) state->base_turn = NAN; /* the contact problem had no solution; NaN makes insertion_is_finite fail, which restarts the insertion */
}

/* Extrapolating the needle's shape only improves the starting point: a needle in steady motion then often needs just one pass. A bad guess costs one or two
   extra passes, which is cheaper than starting over from the last shape. (12 000 steps of a hand that reverses every 13 ms, with the needle in a guide, take
   15 992 passes; 16 539 if guesses are abandoned after three passes; 37 918 without guesses.) */
void equilibrium_find(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output) {
    const needle_model *needle = tick->model->needle;
    pass_result r = {.found = false};
    w->problem.knot = 0;
    if (w->points.tip) damper_keep_dent(state, &w->points, &w->tissue);
    checkpoint_save(state, &w->points, &w->problem, &w->start);
    needle_extrapolate(needle, &state->motion, tick->dt, &state->needle);
    state->motion.time = 0.0;
    begin(tick, state, w);
    if (!state->moving_on) r = passes_run(tick, state, w, output, tick->model->settings.max_passes);
    if (!r.found || r.diverging || r.saddle || r.leapt) r = continuation_follow(tick, state, w, output);
    else if (r.converged) needle_motion_of(needle, &w->start.needle, &state->needle, tick->dt, &state->motion);
    conclude(tick, state, w, output, r);
}

void equilibrium_forget(insertion_state *state) {
    state->base_shift = v3(0, 0, 0);
    state->motion.time = 0.0;
    state->moving_on = false;
}
