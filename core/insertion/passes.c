#include "insertion/passes.h"

#include <string.h>

#include "insertion/contact_assembly.h"
#include "insertion/guides.h"
#include "insertion/needle_drag.h"
#include "insertion/stiffening.h"
#include "insertion/tip_damper.h"

static const double NEW_PUSH = 0.05; /* fraction: of Euler's load; a needle whose push has grown by more since it was linearised is linearised again: else one
                                        that is pushed along its axis at 50 mm/s bears eight times its buckling load before it bows (tests/test_guides.c). Chosen */
static const double LEAP = 0.05; /* rad: turn of a segment; passes that turn one by more in a step may have found another branch than that of the last step, and
                                    a pass that does so, and more than the one before, diverges. Chosen */
static const double CLAMPED_HINGED = 20.2; /* EI / L^2: Euler's load of a beam that is clamped at one end and hinged at the other. Exact: the square of the least
                                              root of tan x = x, 20.19 */

/* ---- needle and problem ---------------------------------------------------------------------------------------------- */

static int first_joint(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    int first = tick->model->needle->given.segments;
    for (int i = 0; i < w->points.count; i++) first = w->points.list[i].at.first < first ? w->points.list[i].at.first : first;
    return first;
}

static void linearise_needle(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    needle_linearise(tick->model->needle, &tick->state->needle, w->response.load, w->response.drag > 0.0 ? 0 : first_joint(tick), &w->response.tangent);
    drag_shift_joints(tick);
    profile_end_stage(&w->profile, INSERTION_NEEDLE);
}

static void assemble_problem(const tick_context *tick, bool first) {
    insertion_workspace *w = tick->scratch;
    w->problem.count = w->points.count;
    w->problem.axial_count = w->points.count + w->points.tip;
    bound_contacts(tick);
    stiffening_linearise(tick, first);
    assemble_compliance(tick);
    assemble_gaps(tick);
    if (w->points.tip) damp_tip(tick);
    int all = unknown(w->problem.count, w->problem.count, 2) + w->points.tip;
    for (int i = 0; i < all && w->continuation.left > 0.0; i++) w->problem.gap[i] -= w->continuation.left * w->continuation.lag[i];
}

void passes_linearise(const tick_context *tick, bool first) {
    linearise_needle(tick);
    assemble_problem(tick, first);
}

/* ---- advance ----------------------------------------------------------------------------------------------------------- */

/* The spring that holds the base yields to the sum of forces. */
static void shift_base(const tick_context *tick) {
    insertion_state *state = tick->state;
    if (tick->base.compliance == 0.0) return;
    vec3 sum = v3(0, 0, 0), before = state->base_shift; /* of the forces: the drag has none */
    for (int j = 0; j <= tick->model->needle->given.segments; j++) sum = v3_add(sum, tick->scratch->response.load[j]);
    state->base_shift = v3_scale(tick->base.compliance, sum);
    pose base = state->needle.base;
    base.position = v3_add(base.position, v3_sub(state->base_shift, before));
    needle_hold(tick->model->needle, base, &state->needle);
}

static void take_forces(const tick_context *tick) {
    insertion_state *state = tick->state;
    const insertion_workspace *w = tick->scratch;
    const contact_problem *p = &w->problem;
    for (int i = 0; i < p->count; i++) {
        const contact_point *point = &w->points.list[i];
        bool at_tip = point->kind == POINT_TIP;
        double length = point->share.to - point->share.from;
        double along = p->force[2 * p->count + i] + (at_tip ? p->force[2 * p->count + i + 1] : 0.0);
        point_set_force(state, point, m3_apply(&point->at.frame, v3(p->force[2 * i], p->force[2 * i + 1], along)));
        if (point->kind == POINT_GUIDE) {
            guides_take(tick, i);
        } else if (at_tip) {
            state->tip.solved.end_force = p->force[2 * p->count + i];
            state->tip.solved.arc = point->arc;
            state->tip.shaft.traction = p->force[2 * p->count + i + 1] / length;
            state->tip.solved.slip = p->slip[i];
            state->tip.solved.friction = p->state[i];
            state->tip.shaft.slip = p->slip[i + 1];
            state->tip.shaft.friction = p->state[i + 1];
        } else {
            shaft_contact *contact = &state->contacts[point->handle];
            contact->shaft.traction = along / length;
            contact->shaft.slip = p->slip[i];
            contact->shaft.friction = p->state[i];
        }
    }
}

void passes_load_joints(const tick_context *tick) {
    load_needle(tick);
    drag_add_loads(tick);
}

/* The solution's forces bend the needle. Returns the largest turn of a segment, rad. */
static double advance(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    take_forces(tick);
    if (w->points.tip && w->stiffening.any) take_damping(tick);
    profile_end_stage(&w->profile, INSERTION_CONTACT);
    passes_load_joints(tick);
    shift_base(tick);
    double turned = needle_advance(tick->model->needle, &w->response.tangent, w->response.load, &tick->state->needle);
    locate_points(tick);
    profile_end_stage(&w->profile, INSERTION_NEEDLE);
    return turned;
}

/* ---- the loop ---------------------------------------------------------------------------------------------------------- */

void passes_begin(const tick_context *tick) {
    locate_points(tick);
    passes_load_joints(tick);
}

/* Largest turn of a segment since it had this shape, rad. */
double passes_turned_since(const tick_context *tick, const needle_state *shape) {
    const vec3 *now = tick->state->needle.joints, *start = shape->joints;
    double most = 0.0;
    for (int k = 0; k < tick->model->needle->given.segments; k++)
        most = fmax(most, v3_norm(v3_sub(v3_unit(v3_sub(now[k + 1], now[k])), v3_unit(v3_sub(start[k + 1], start[k])))));
    return most;
}

/* Sum of the forces of all points on tissue and guides, N. */
static vec3 push_on(const tick_context *tick) {
    insertion_state *state = tick->state;
    const insertion_workspace *w = tick->scratch;
    vec3 sum = w->points.tip ? state->tip.solved.force : v3(0, 0, 0);
    for (int i = 0; i < w->points.count - w->points.tip; i++) sum = v3_add(sum, point_force(state, &w->points.list[i]));
    return sum;
}

double euler_load(const needle_model *needle) {
    return CLAMPED_HINGED * needle->bending / (needle->given.length * needle->given.length);
}

pass_result passes_run(const tick_context *tick, int most) {
    const insertion_model *model = tick->model;
    insertion_workspace *w = tick->scratch;
    pass_result r = {.found = true};
    double turned = 0.0, before = 0.0, all_turns = 0.0, length = model->needle->given.length;
    vec3 push = push_on(tick);
    for (int pass = 0; pass < most && r.found && !r.converged; pass++) {
        tick->output->passes++;
        before = turned;
        passes_linearise(tick, pass == 0);
        r.found = contact_solve(&w->problem) == TROCAR_OK;
        if (r.found) {
            tick->output->switches += w->problem.switches;
            turned = advance(tick);
        }
        all_turns += turned;
        vec3 now = push_on(tick), more = v3_sub(now, push);
        push = now;
        r.converged = turned * turned * length < model->settings.tolerance && v3_norm(more) < NEW_PUSH * euler_load(model->needle) && guides_agree(tick) && stiffening_agrees(tick);
    }
    /* A state from which the passes diverge is no equilibrium. A single pass cannot tell. */
    r.diverging = before > 0.0 && turned > before && turned > LEAP;
    r.saddle = w->problem.negative < w->response.tangent.unstable; /* by Haynsworth's inertia formula: see README.md, "One tick is one convex problem" */
    r.leapt = all_turns > LEAP && passes_turned_since(tick, &w->start.needle) > LEAP;
    return r;
}
