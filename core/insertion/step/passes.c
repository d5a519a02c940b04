#include "insertion/step/passes.h"

#include <string.h>

#include "insertion/contact/contact_assembly.h"
#include "insertion/contact/tip_damper.h"
#include "insertion/guide/guides.h"
#include "insertion/laws/stiffening.h"
#include "insertion/step/checkpoint.h"
#include "insertion/step/needle_drag.h"

static const double NEW_PUSH = 0.05; /* fraction of the Euler load: if the push changes by more than this in a pass, the needle is linearised again. Otherwise a
                                        needle pushed along its axis at 50 mm/s would bear eight times its buckling load before it bows
                                        (tests/unit/insertion/test_guides.c). Chosen by judgement */
static const double LEAP = 0.05; /* rad: a segment that rotates by more than this within one step may be on another branch of equilibria. A pass diverges if it
                                    rotates a segment by more than this and by more than the previous pass did. Chosen by judgement */
static const double CLAMPED_HINGED = 20.2; /* in units of EI / L^2: Euler load of a beam clamped at one end and hinged at the other. Exact: the square of the
                                              smallest root of tan x = x, 20.19 */

/* ---- needle and problem ---------------------------------------------------------------------------------------------- */

static int first_joint(const tick_input *tick, const contact_points *points) {
    int first = tick->model->needle->given.segments;
    for (int i = 0; i < points->count; i++) first = points->list[i].at.first < first ? points->list[i].at.first : first;
    return first;
}

static void linearise_needle(const tick_input *tick, const insertion_state *state, const contact_points *points, needle_response *response, const pass_checkpoint *start,
                             insertion_profile *profile) {
    needle_linearise(tick->model->needle, &state->needle, response->load, response->drag > 0.0 ? 0 : first_joint(tick, points), &response->tangent);
    drag_shift_joints(tick, response, start);
    profile_end_part(profile, TIMED_NEEDLE);
}

static void assemble_problem(const tick_input *tick, const insertion_state *state, insertion_workspace *w, bool first) {
    w->problem.count = w->points.count;
    w->problem.axial_count = w->points.count + w->points.tip;
    bound_contacts(tick, state, &w->points, &w->tissue, &w->ahead, w->edges, &w->problem);
    stiffening_linearise(tick, state, &w->points, &w->tissue, &w->creep, &w->stiffening, &w->damper, first);
    assemble_compliance(tick, state, w);
    assemble_gaps(tick, state, w);
    if (w->points.tip) damper_eliminate(tick, state, w);
    int all = unknown(w->problem.count, w->problem.count, 2) + w->points.tip;
    for (int i = 0; i < all && w->continuation.kept_open > 0.0; i++) w->problem.gap[i] -= w->continuation.kept_open * w->continuation.lag[i];
}

void passes_linearise(const tick_input *tick, const insertion_state *state, insertion_workspace *w, bool first) {
    linearise_needle(tick, state, &w->points, &w->response, &w->start, &w->profile);
    assemble_problem(tick, state, w, first);
}

/* ---- advance ----------------------------------------------------------------------------------------------------------- */

/* Deflects the spring that holds the base by the sum of the contact forces. */
static void shift_base(const tick_input *tick, insertion_state *state, const needle_response *response) {
    if (tick->base.compliance == 0.0) return;
    vec3 sum = v3(0, 0, 0), before = state->base_shift; /* the drag is in these loads too, but its forces add up to zero */
    for (int j = 0; j <= tick->model->needle->given.segments; j++) sum = v3_add(sum, response->load[j]);
    state->base_shift = v3_scale(tick->base.compliance, sum);
    pose base = state->needle.base;
    base.position = v3_add(base.position, v3_sub(state->base_shift, before));
    needle_move_base(tick->model->needle, base, &state->needle);
}

static void take_forces(insertion_state *state, const contact_points *points, const hole_edge *edges, const contact_problem *problem) {
    for (int i = 0; i < problem->count; i++) {
        const contact_point *point = &points->list[i];
        bool at_tip = point->kind == POINT_TIP;
        double length = point->share.to - point->share.from;
        double along = problem->force[2 * problem->count + i] + (at_tip ? problem->force[2 * problem->count + i + 1] : 0.0);
        point_set_force(state, point, m3_apply(&point->at.frame, v3(problem->force[2 * i], problem->force[2 * i + 1], along)));
        if (point->kind == POINT_GUIDE) {
            guides_take(state, points, edges, problem, i);
        } else if (at_tip) {
            state->tip.solved.end_force = problem->force[2 * problem->count + i];
            state->tip.solved.arc = point->arc;
            state->tip.shaft.traction = problem->force[2 * problem->count + i + 1] / length;
            state->tip.solved.slip = problem->slip[i];
            state->tip.solved.friction = problem->state[i];
            state->tip.shaft.slip = problem->slip[i + 1];
            state->tip.shaft.friction = problem->state[i + 1];
        } else {
            shaft_contact *contact = &state->contacts[point->handle];
            contact->shaft.traction = along / length;
            contact->shaft.slip = problem->slip[i];
            contact->shaft.friction = problem->state[i];
        }
    }
}

void passes_load_joints(const tick_input *tick, const insertion_state *state, const contact_points *points, needle_response *response, const pass_checkpoint *start) {
    points_load_needle(tick, state, points, response);
    drag_add_loads(tick, response, start);
}

/* Applies the solution's forces to the needle and bends it. Returns the largest rotation of a segment (rad). */
static double advance(const tick_input *tick, insertion_state *state, insertion_workspace *w) {
    take_forces(state, &w->points, w->edges, &w->problem);
    if (w->points.tip && w->stiffening.any) damper_find_force(tick, state, w);
    profile_end_part(&w->profile, TIMED_CONTACT);
    passes_load_joints(tick, state, &w->points, &w->response, &w->start);
    shift_base(tick, state, &w->response);
    double turned = needle_advance(tick->model->needle, &w->response.tangent, w->response.load, &state->needle);
    points_locate(tick, state, &w->points, &w->tissue, &w->creep, w->edges);
    profile_end_part(&w->profile, TIMED_NEEDLE);
    return turned;
}

/* ---- the loop ---------------------------------------------------------------------------------------------------------- */

void passes_begin(const tick_input *tick, const insertion_state *state, insertion_workspace *w) {
    points_locate(tick, state, &w->points, &w->tissue, &w->creep, w->edges);
    passes_load_joints(tick, state, &w->points, &w->response, &w->start);
}

/* Copies the forces in the state to the contact problem. */
static void give_forces(const insertion_state *state, const contact_points *points, contact_problem *problem) {
    int n = points->count;
    for (int i = 0; i < n; i++) {
        vec3 f = m3_apply_transposed(&points->list[i].at.frame, point_force(state, &points->list[i]));
        problem->force[unknown(n, i, 0)] = f.x;
        problem->force[unknown(n, i, 1)] = f.y;
        problem->force[unknown(n, i, 2)] = f.z;
    }
    if (!points->tip) return;
    int tip = unknown(n, n - 1, 2);
    double shaft = state->tip.shaft.traction * (points->list[n - 1].share.to - points->list[n - 1].share.from);
    problem->force[tip] -= shaft;
    problem->force[tip + 1] = shaft;
}

void passes_go_back(const tick_input *tick, insertion_state *state, insertion_workspace *w) {
    checkpoint_restore(state, &w->points, &w->problem, &w->start);
    passes_begin(tick, state, w);
    passes_linearise(tick, state, w, true);
    give_forces(state, &w->points, &w->problem);
}

/* Returns the largest rotation (rad) of a segment relative to `shape`. */
double passes_turned_since(const tick_input *tick, const insertion_state *state, const needle_state *shape) {
    const vec3 *now = state->needle.joints, *start = shape->joints;
    double most = 0.0;
    for (int k = 0; k < tick->model->needle->given.segments; k++)
        most = fmax(most, v3_norm(v3_sub(v3_unit(v3_sub(now[k + 1], now[k])), v3_unit(v3_sub(start[k + 1], start[k])))));
    return most;
}

/* Returns the sum of the forces (N) that the needle exerts on tissue and guides. */
static vec3 push_on(const insertion_state *state, const contact_points *points) {
    vec3 sum = points->tip ? state->tip.solved.force : v3(0, 0, 0);
    for (int i = 0; i < points->count - points->tip; i++) sum = v3_add(sum, point_force(state, &points->list[i]));
    return sum;
}

double euler_load(const needle_model *needle) {
    return CLAMPED_HINGED * needle->bending / (needle->given.length * needle->given.length);
}

/* True if the linearisation still holds after a pass that rotated a segment by `turned` (rad) and changed the force on tissue and guides by `more` (N). */
static bool has_converged(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, double turned, vec3 more) {
    const needle_model *needle = tick->model->needle;
    if (!(turned * turned * needle->given.length < tick->model->settings.tolerance && v3_norm(more) < NEW_PUSH * euler_load(needle))) return false;
    return guides_agree(&w->points, w->edges) && stiffening_agrees(tick, state, &w->points, &w->tissue, &w->creep, &w->stiffening, &w->damper);
}

pass_result passes_run(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output, int most) {
    pass_result r = {.found = true};
    double turned = 0.0, before = 0.0, all_turns = 0.0;
    vec3 push = push_on(state, &w->points);
    for (int pass = 0; pass < most && r.found && !r.converged; pass++) {
        output->passes++;
        before = turned;
        linearise_needle(tick, state, &w->points, &w->response, &w->start, &w->profile);
        assemble_problem(tick, state, w, pass == 0);
        r.found = contact_solve(&w->problem) == TROCAR_OK;
        if (r.found) turned = advance(tick, state, w);
        output->switches += r.found ? w->problem.switches : 0;
        all_turns += turned;
        vec3 now = push_on(state, &w->points);
        r.converged = has_converged(tick, state, w, turned, v3_sub(now, push));
        push = now;
    }
    /* passes that diverge from a state show that it is no equilibrium; it takes two passes to see this */
    r.diverging = before > 0.0 && turned > before && turned > LEAP;
    r.saddle = w->problem.negative < w->response.tangent.unstable; /* by Haynsworth's inertia formula; see docs/mechanics.md, "One tick is one convex
                                                                      problem" */
    r.leapt = all_turns > LEAP && passes_turned_since(tick, state, &w->start.needle) > LEAP;
    return r;
}
