#include "insertion/step/continuation.h"

#include "insertion/step/checkpoint.h"
#include "insertion/step/needle_drag.h"

static const double AT_REST = 5e-3; /* fraction of the Euler load: a moving needle whose drag is below this counts as at rest. Chosen: 0.05 N for a 200 mm, 18 G
                                       needle, about the smallest force that a hand feels */
static const double LEAST_STEP = 1.0 / 256; /* fraction of a step: smallest increment tried when following a branch of equilibria. Cost limit: eight halvings */
enum { LAST_PASSES = 3 }; /* passes: most spent checking whether a needle has come to rest. Cost limit */

/* Computes by how much each gap differs from the one that would balance the forces at the start of the step. The difference comes from the base's motion. */
static void find_lag(insertion_workspace *w) {
    const contact_problem *p = &w->problem;
    int all = unknown_count(p);
    for (int i = 0; i < all; i++) {
        w->continuation.lag[i] = p->gap[i];
        for (int j = 0; j < all; j++) w->continuation.lag[i] -= compliance_of(p, i, j) * p->force[j];
    }
}

/* True if the needle has hardly moved in this step, so that its drag is negligible. */
static bool is_at_rest(const tick_input *tick, const insertion_state *state, const needle_state *since) {
    const needle_model *needle = tick->model->needle;
    return needle_drag(needle) / tick->dt * passes_turned_since(tick, state, since) < AT_REST * euler_load(needle);
}

/* Checks whether a needle that has hardly moved is in equilibrium, which it is if the passes converge to a stable state without drag. If not, restores the
   state reached with drag. */
static pass_result come_to_rest(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output, pass_result moved) {
    double drag = w->response.drag;
    checkpoint_save(state, &w->points, &w->problem, &w->start);
    w->response.drag = 0.0;
    passes_load_joints(tick, state, &w->points, &w->response, &w->start);
    pass_result r = passes_run(tick, state, w, output, LAST_PASSES);
    state->moving_on = !(passes_are_stable(r) && is_at_rest(tick, state, &w->start.needle));
    if (!state->moving_on) return r;
    w->response.drag = drag;
    passes_go_back(tick, state, w);
    return moved;
}

/* Closes the gaps in small increments. When the tip pushes against bone, one large step would find the straight needle, which is unstable above the Euler load.
   Small increments follow the branch on which the needle bows. Where that branch ends, the needle moves to another branch against its drag. The drag is
   inversely proportional to the increment, so a short enough increment is stable under any compression. */
pass_result continuation_follow(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output) {
    double drag = needle_drag(tick->model->needle) / tick->dt, done = 0.0, step = 1.0;
    bool moving_on = state->moving_on;
    needle_state before = w->start.needle;
    pass_result r = {.found = false};
    passes_go_back(tick, state, w);
    find_lag(w);
    while (done < 1.0 && step >= LEAST_STEP) {
        w->continuation.kept_open = 1.0 - (done + step);
        w->response.drag = state->moving_on ? drag / step : 0.0;
        passes_load_joints(tick, state, &w->points, &w->response, &w->start);
        r = passes_run(tick, state, w, output, tick->model->settings.max_passes);
        if (passes_are_stable(r) && (state->moving_on || !r.leapt)) checkpoint_save(state, &w->points, &w->problem, &w->start), done += step;
        else passes_go_back(tick, state, w), step *= 0.5;
        if (step < LEAST_STEP && !state->moving_on) state->moving_on = true, step = 1.0 - done;
        step = fmin(step, 1.0 - done);
    }
    w->continuation.kept_open = 0.0;
    return moving_on && is_at_rest(tick, state, &before) ? come_to_rest(tick, state, w, output, r) : r;
}
