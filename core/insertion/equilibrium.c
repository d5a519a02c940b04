#include "insertion/equilibrium.h"

#include <string.h>

#include "insertion/contact_assembly.h"
#include "insertion/creep.h"
#include "insertion/guides.h"
#include "insertion/needle_drag.h"
#include "insertion/resistance_ahead.h"
#include "insertion/roll.h"
#include "insertion/stiffening.h"
#include "insertion/tip_damper.h"

static const double BITE_TIME = 20e-3; /* s: lag with which the surface's hold follows the force along the needle; without it, the two would alternate. Chosen */
static const double NEW_PUSH = 0.05; /* fraction: of Euler's load; a needle whose push has grown by more since it was linearised is linearised again: else one
                                        that is pushed along its axis at 50 mm/s bears eight times its buckling load before it bows (tests/unit/insertion/test_guides.c). Chosen */
static const double AT_REST = 5e-3; /* fraction: of Euler's load; a needle that moves on and is dragged by less has come to rest. Chosen: for an 18 G needle of
                                       200 mm 0.05 N, about the smallest force that a hand feels */
static const double LEAST_STEP = 1.0 / 256; /* fraction: of a tick, in which the branch of an equilibrium is followed at last. Effort: eight halvings */
enum { GUESS_PASSES = 3 }; /* passes: from a guessed shape, before it is given up. Effort */
static const double LEAP = 0.05; /* rad: turn of a segment; passes that turn one by more in a step may have found another branch than that of the last step, and
                                    a pass that does so, and more than the one before, diverges. Chosen */
static const double CLAMPED_HINGED = 20.2; /* EI / L^2: Euler's load of a beam that is clamped at one end and hinged at the other. Exact: the square of the least
                                              root of tan x = x, 20.19 */

/* ---- one pass ------------------------------------------------------------------------------------------------------ */

/* The spring that holds the base yields to the sum of forces. */
static void shift_base(const tick_context *tick) {
    insertion_state *state = tick->state;
    if (tick->base.compliance == 0.0) return;
    vec3 sum = v3(0, 0, 0), before = state->base_shift; /* of the forces: the drag has none */
    for (int j = 0; j <= tick->model->needle->given.segments; j++) sum = v3_add(sum, tick->scratch->load[j]);
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
        const contact_point *point = &w->points[i];
        bool at_tip = point->kind == POINT_TIP;
        double length = point->share.to - point->share.from;
        double along = p->force[2 * p->count + i] + (at_tip ? p->force[2 * p->count + i + 1] : 0.0);
        *point_force(state, point) = m3_apply(&point->at.frame, v3(p->force[2 * i], p->force[2 * i + 1], along));
        if (point->kind == POINT_GUIDE) {
            guides_take(tick, i);
        } else if (at_tip) {
            state->tip.end_force = p->force[2 * p->count + i];
            state->tip.arc = point->arc;
            state->tip.shaft.traction = p->force[2 * p->count + i + 1] / length;
            state->tip.slip = p->slip[i];
            state->tip.friction = p->state[i];
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

static void load_joints(const tick_context *tick) {
    load_needle(tick);
    drag_add_loads(tick);
}

/* Starts from the last solve's shape and forces. */
static void prepare(const tick_context *tick, const int handles[4]) {
    insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    list_points(tick);
    w->problem.count = w->point_count;
    w->problem.axial_count = w->point_count + w->tip;
    creep_share_out(tick);
    if (w->tip) find_tip_rows(tick, handles);
    w->problem.knot = 0;
    w->relaxed = w->tip ? tip_relaxed(tick->model, &state->tip, tick->dt) : 1.0;
    keep_shear(tick);
    find_local_compliance(tick);
    stiffening_prepare(tick);
    creep_recall(tick);
    locate_points(tick);
    if (w->tip) resistance_ahead_find(tick);
    w->drag = 0.0;
    load_needle(tick);
    profile_end_stage(&w->profile, INSERTION_TISSUE);
}

static int first_joint(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    int first = tick->model->needle->given.segments;
    for (int i = 0; i < w->point_count; i++) first = w->points[i].at.first < first ? w->points[i].at.first : first;
    return first;
}

/* Linearises the needle and puts the contact problem together. */
static void linearise(const tick_context *tick, bool first) {
    insertion_workspace *w = tick->scratch;
    needle_linearise(tick->model->needle, &tick->state->needle, w->load, w->drag > 0.0 ? 0 : first_joint(tick), &w->tangent);
    drag_shift_joints(tick);
    profile_end_stage(&w->profile, INSERTION_NEEDLE);
    bound_contacts(tick);
    stiffening_linearise(tick, first);
    if (w->tip && w->node_added) keep_dent(tick);
    w->node_added = false;
    assemble_compliance(tick);
    assemble_gaps(tick);
    if (w->tip) damp_tip(tick);
}

void equilibrium_linearise(const tick_context *tick, const int handles[4], bool loaded) {
    prepare(tick, handles);
    if (!loaded) memset(tick->scratch->load, 0, sizeof tick->scratch->load);
    tick->scratch->relaxed = 1.0; /* at rest, nothing springs back */
    linearise(tick, true);
}

/* Linearises the needle, solves the contact problem and turns the needle's segments, by at most `turned` rad. False: there is no
   equilibrium. */
static bool solve_pass(const tick_context *tick, bool first, double *turned) {
    insertion_workspace *w = tick->scratch;
    tick->output->passes++;
    linearise(tick, first);
    int all = unknown(w->problem.count, w->problem.count, 2) + w->tip;
    for (int i = 0; i < all && w->lag_left > 0.0; i++) w->problem.gap[i] -= w->lag_left * w->lag[i];
    if (contact_solve(&w->problem) != TROCAR_OK) return false;
    tick->output->switches += w->problem.switches;
    take_forces(tick);
    if (w->tip && w->stiffening.any) take_damping(tick);
    profile_end_stage(&w->profile, INSERTION_CONTACT);
    load_joints(tick);
    shift_base(tick);
    *turned = needle_advance(tick->model->needle, &w->tangent, w->load, &tick->state->needle);
    locate_points(tick);
    profile_end_stage(&w->profile, INSERTION_NEEDLE);
    return true;
}

/* By Haynsworth's inertia formula: see README.md, "One tick is one convex problem". */
static bool is_saddle(const insertion_workspace *w) { return w->problem.negative < w->tangent.unstable; }

/* ---- the solve ----------------------------------------------------------------------------------------------------- */

static void follow_pressing(needle_tip *tip, const needle_point *p, double dt) {
    double pressing = fmax(v3_dot(tip->force, needle_along(p)), 0.0);
    tip->pressing += (pressing - tip->pressing) * -expm1(-dt / BITE_TIME);
}

/* Sum of the forces of all points on tissue and guides, N. */
static vec3 push_on(const tick_context *tick) {
    insertion_state *state = tick->state;
    const insertion_workspace *w = tick->scratch;
    vec3 sum = w->tip ? state->tip.force : v3(0, 0, 0);
    for (int i = 0; i < w->point_count - w->tip; i++) sum = v3_add(sum, *point_force(state, &w->points[i]));
    return sum;
}

/* Of the needle clamped at its base and hinged at its tip, N. */
static double euler_load(const tick_context *tick) {
    const needle_model *needle = tick->model->needle;
    return CLAMPED_HINGED * needle->bending / (needle->given.length * needle->given.length);
}

typedef struct {
    bool found, converged, diverging;
    double turned;           /* rad, at most: by all passes together */
} pass_result;

/* Newton passes from the present shape. */
static pass_result run_passes(const tick_context *tick, int most) {
    const insertion_model *model = tick->model;
    pass_result r = {.found = true};
    double turned = 0.0, before = 0.0, length = model->needle->given.length;
    vec3 push = push_on(tick);
    for (int pass = 0; pass < most && r.found && !r.converged; pass++) {
        before = turned;
        r.found = solve_pass(tick, pass == 0, &turned);
        r.turned += turned;
        vec3 now = push_on(tick), more = v3_sub(now, push);
        push = now;
        r.converged = turned * turned * length < model->settings.tolerance && v3_norm(more) < NEW_PUSH * euler_load(tick) && guides_agree(tick) && stiffening_agrees(tick);
    }
    /* A state from which the passes diverge is no equilibrium. A single pass cannot tell. */
    r.diverging = before > 0.0 && turned > before && turned > LEAP;
    return r;
}

/* Keeps the shape at the start of the tick. */
static void remember_shape(const tick_context *tick) {
    tick->scratch->start = tick->state->needle;
    tick->scratch->start_shift = tick->state->base_shift;
}

static point_solution solution_at(const insertion_state *state, const contact_point *p) {
    if (p->kind == POINT_GUIDE) {
        const guide_contact *face = &state->guides[p->guide].faces[p->face];
        return (point_solution){.force = face->force, .slip = face->slip, .friction = face->friction, .touching = face->touching};
    }
    if (p->kind == POINT_TIP)
        return (point_solution){.force = state->tip.force, .traction = state->tip.shaft.traction, .slip = state->tip.slip, .friction = state->tip.friction};
    const shaft_contact *contact = &state->contacts[p->handle];
    return (point_solution){.force = contact->force, .traction = contact->shaft.traction, .slip = contact->shaft.slip, .friction = contact->shaft.friction};
}

static void set_solution(insertion_state *state, const contact_point *p, const point_solution *s) {
    *point_force(state, p) = s->force;
    if (p->kind == POINT_GUIDE) {
        guide_contact *face = &state->guides[p->guide].faces[p->face];
        face->slip = s->slip;
        face->friction = s->friction;
        face->touching = s->touching;
    } else if (p->kind == POINT_TIP) {
        state->tip.shaft.traction = s->traction;
        state->tip.slip = s->slip;
        state->tip.friction = s->friction;
    } else {
        shaft_contact *contact = &state->contacts[p->handle];
        contact->shaft.traction = s->traction;
        contact->shaft.slip = s->slip;
        contact->shaft.friction = s->friction;
    }
}

/* Keeps all that the passes change of the points, at the start of the tick. */
static void remember_points(const tick_context *tick) {
    const needle_tip *tip = &tick->state->tip;
    insertion_workspace *w = tick->scratch;
    for (int i = 0; i < w->point_count; i++) w->start_points[i] = solution_at(tick->state, &w->points[i]);
    w->start_tip = (tip_solution){tip->damping, tip->end_force, tip->shaft.slip, tip->shaft.friction, w->problem.knot};
}

/* How far the gaps differ from those that balance the forces at the start of the tick: the base has moved; a tip at bone has not. */
static void find_lag(const tick_context *tick) {
    insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    contact_problem *p = &w->problem;
    double force[MAX_UNKNOWNS];
    int tip = p->count - 1, all = unknown(p->count, p->count, 2) + w->tip;
    linearise(tick, true);
    for (int i = 0; i < p->count; i++) {
        vec3 f = m3_apply_transposed(&w->points[i].at.frame, *point_force(state, &w->points[i]));
        force[unknown(p->count, i, 0)] = f.x;
        force[unknown(p->count, i, 1)] = f.y;
        force[unknown(p->count, i, 2)] = f.z;
    }
    if (w->tip) {
        double shaft = state->tip.shaft.traction * (w->points[tip].share.to - w->points[tip].share.from);
        force[all - 2] -= shaft;
        force[all - 1] = shaft;
    }
    for (int i = 0; i < all; i++) {
        w->lag[i] = p->gap[i];
        for (int j = 0; j < all; j++) w->lag[i] -= (i < j ? p->compliance[i][j] : p->compliance[j][i]) * force[j];
    }
}

/* Restores what was remembered: the passes that follow find the same, to the bit, as if there had been none before. */
static void recall(const tick_context *tick) {
    insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    state->needle = w->start;
    state->base_shift = w->start_shift;
    for (int i = 0; i < w->point_count; i++) set_solution(state, &w->points[i], &w->start_points[i]);
    state->tip.damping = w->start_tip.damping;
    state->tip.end_force = w->start_tip.end_force;
    state->tip.shaft.slip = w->start_tip.shaft_slip;
    state->tip.shaft.friction = w->start_tip.shaft_friction;
    w->problem.knot = w->start_tip.knot;
    locate_points(tick);
    load_joints(tick);
}

/* Largest turn of a segment since it had this shape, rad. */
static double turned_since(const tick_context *tick, const needle_state *shape) {
    const vec3 *now = tick->state->needle.joints, *start = shape->joints;
    double most = 0.0;
    for (int k = 0; k < tick->model->needle->given.segments; k++)
        most = fmax(most, v3_norm(v3_sub(v3_unit(v3_sub(now[k + 1], now[k])), v3_unit(v3_sub(start[k + 1], start[k])))));
    return most;
}

static bool is_stable(const tick_context *tick, pass_result r) { return r.found && r.converged && !is_saddle(tick->scratch); }

static bool has_leapt(const tick_context *tick, pass_result r) { return r.turned > LEAP && turned_since(tick, &tick->scratch->start) > LEAP; }

/* Repeats the tick, closing the gaps in small steps. One large step against bone finds the straight needle, which beyond
   Euler's load is not stable; small steps follow the branch on which it bows. Where that branch ends, the needle moves on against its drag: the shorter
   the step, the more that holds it, until it is stable whatever compresses it. */
static pass_result follow(const tick_context *tick) {
    insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    double drag = needle_drag(tick->model->needle) / tick->dt, done = 0.0, step = 1.0;
    pass_result r = {.found = false};
    find_lag(tick);
    while (done < 1.0 && step >= LEAST_STEP) {
        w->lag_left = 1.0 - (done + step);
        w->drag = state->moving_on ? drag / step : 0.0;
        load_joints(tick);
        r = run_passes(tick, tick->model->settings.max_passes);
        if (is_stable(tick, r) && (state->moving_on || !has_leapt(tick, r))) remember_shape(tick), remember_points(tick), done += step;
        else recall(tick), step *= 0.5;
        if (step < LEAST_STEP && !state->moving_on) state->moving_on = true, step = 1.0 - done;
        step = fmin(step, 1.0 - done);
    }
    w->lag_left = 0.0;
    return r;
}

/* ---- without an equilibrium near ----------------------------------------------------------------------------------------- */

/* The needle has hardly moved on in this step: what would drag it is nothing. */
static bool is_at_rest(const tick_context *tick, const needle_state *since) {
    return needle_drag(tick->model->needle) / tick->dt * turned_since(tick, since) < AT_REST * euler_load(tick);
}

/* A needle that has hardly moved on is at an equilibrium, if that is stable and the passes find it. */
static pass_result come_to_rest(const tick_context *tick, pass_result moved) {
    insertion_workspace *w = tick->scratch;
    double drag = w->drag;
    remember_shape(tick);
    remember_points(tick);
    w->drag = 0.0;
    load_joints(tick);
    pass_result r = run_passes(tick, GUESS_PASSES);
    tick->state->moving_on = !(is_stable(tick, r) && is_at_rest(tick, &w->start));
    if (!tick->state->moving_on) return r;
    recall(tick);
    w->drag = drag;
    return moved;
}

/* ---- the tick -------------------------------------------------------------------------------------------------------------- */

/* The equilibrium that the passes find at once, as nearly always. A needle that goes on as in the last step often needs only one pass. */
static pass_result find_at_once(const tick_context *tick, bool guessed) {
    int most = tick->model->settings.max_passes;
    pass_result r = run_passes(tick, guessed && most > GUESS_PASSES ? GUESS_PASSES : most);
    tick->scratch->guess_given_up = guessed && !(r.found && r.converged && !r.diverging);
    if (tick->scratch->guess_given_up) {
        recall(tick);
        r = run_passes(tick, most);
    }
    return r;
}

void equilibrium_find(const tick_context *tick, const int handles[4]) {
    insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    w->lag_left = 0.0;
    remember_shape(tick);
    bool guessed = needle_go_on(tick->model->needle, &state->motion, tick->dt, &state->needle);
    prepare(tick, handles);
    remember_points(tick);
    if (w->tip) state->tip.rest = w->points[w->point_count - 1].target;
    pass_result r;
    if (state->moving_on) {
        needle_state before = w->start;
        r = follow(tick);
        if (is_at_rest(tick, &before)) r = come_to_rest(tick, r);
        state->motion.time = 0.0;
    } else {
        r = find_at_once(tick, guessed);
        state->motion.time = 0.0;
        if (!r.found || r.diverging || is_saddle(w) || has_leapt(tick, r)) recall(tick), r = follow(tick);
        else if (r.converged) needle_motion_of(tick->model->needle, &w->start, &state->needle, tick->dt, &state->motion);
    }
    if (!r.converged) tick->output->events |= EVENT_INEXACT;
    if (w->tip && r.found) state->tip.follows = resistance_ahead_track(tick);
    if (w->tip) spring_back(tick);
    roll_solve(tick);
    creep_remember(tick);
    if (w->tip) follow_pressing(&state->tip, &w->points[w->point_count - 1].at, tick->dt);
}

void equilibrium_forget(insertion_state *state) {
    state->base_shift = v3(0, 0, 0);
    state->motion.time = 0.0;
    state->moving_on = false;
}
