#include "insertion/equilibrium.h"

#include <string.h>

#include "insertion/contact_assembly.h"
#include "insertion/creep.h"
#include "insertion/guides.h"
#include "insertion/old_tracks.h"
#include "insertion/roll.h"
#include "insertion/stiffening.h"
#include "insertion/tip_damper.h"
#include "insertion/tip_path.h"

static const double BITE_TIME = 20e-3;   /* s, lag with which the tip's hold follows the force along the needle: without it, the two would alternate */
static const double NEW_PUSH = 0.05;     /* of Euler's load: if the push has grown by more since the needle was linearised, it is linearised again */
static const double LEAST_LOST = 1e-4;   /* N that a track takes off the viscosity, from which on tissue counts as springing back */
enum { GUESS_PASSES = 2 };               /* from a guessed shape, before it is given up */
enum { MOST_ENDS = 4 };                  /* of old tracks that the tip may come to in one tick */
static const double DIVERGING = 0.05;    /* rad: passes diverge if the last one turned a segment by more, and by more than the pass before */

/* ---- one pass ------------------------------------------------------------------------------------------------------ */

/* The spring that holds the base yields to the sum of forces. */
static void shift_base(const tick_context *tick) {
    insertion_state *state = tick->state;
    if (tick->base.compliance == 0.0) return;
    vec3 sum = v3(0, 0, 0), before = state->base_shift;
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
            state->tip.shaft_traction = p->force[2 * p->count + i + 1] / length;
            state->tip.slip = p->slip[i] + w->slip_offset;
            state->tip.friction = p->state[i];
            state->tip.shaft_slip = p->slip[i + 1];
            state->tip.shaft_friction = p->state[i + 1];
        } else {
            shaft_contact *contact = &state->contacts[point->handle];
            contact->traction = along / length;
            contact->slip = p->slip[i];
            contact->friction = p->state[i];
        }
    }
}

static void set_tip_law(const tick_context *tick, tip_law law, double slip_offset) {
    tick->scratch->tip_law = law;
    tick->scratch->slip_offset = slip_offset;
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
    set_tip_law(tick, TIP_CUTS, 0.0);
    w->relaxed = w->tip ? tip_relaxed(tick->model, &state->tip, tick->dt) : 1.0;
    keep_shear(tick);
    find_local_compliance(tick);
    stiffening_prepare(tick);
    creep_recall(tick);
    locate_points(tick);
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
static void linearise(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    needle_linearise(tick->model->needle, &tick->state->needle, w->load, first_joint(tick), &w->tangent);
    profile_end_stage(&w->profile, INSERTION_NEEDLE);
    bound_contacts(tick);
    stiffening_linearise(tick);
    assemble_compliance(tick);
    assemble_gaps(tick);
    if (w->tip) damp_tip(tick);
    int tip = unknown(w->problem.count, w->problem.count - 1, 2);
    if (w->tip) w->tip_compliance = w->problem.compliance[tip][tip];
}

void equilibrium_linearise(const tick_context *tick, const int handles[4], bool loaded) {
    prepare(tick, handles);
    if (!loaded) memset(tick->scratch->load, 0, sizeof tick->scratch->load);
    tick->scratch->relaxed = 1.0; /* at rest, nothing springs back */
    linearise(tick);
}

/* Linearises the needle, solves the contact problem and turns the needle's segments, by at most `turned` rad. False: there is no
   equilibrium. */
static bool solve_pass(const tick_context *tick, double *turned) {
    insertion_workspace *w = tick->scratch;
    tick->output->passes++;
    linearise(tick);
    int all = unknown(w->problem.count, w->problem.count, 2) + w->tip;
    for (int i = 0; i < all && w->lag_left > 0.0; i++) w->problem.gap[i] -= w->lag_left * w->lag[i];
    if (contact_solve(&w->problem) != TROCAR_OK) return false;
    tick->output->switches += w->problem.switches;
    take_forces(tick);
    if (w->tip && w->stiffening.any) take_damping(tick);
    profile_end_stage(&w->profile, INSERTION_CONTACT);
    load_needle(tick);
    shift_base(tick);
    *turned = needle_advance(tick->model->needle, &w->tangent, w->load, &tick->state->needle);
    locate_points(tick);
    profile_end_stage(&w->profile, INSERTION_NEEDLE);
    return true;
}

/* ---- without equilibrium ------------------------------------------------------------------------------------------- */

void equilibrium_release(insertion_state *state) {
    for (int k = 0; contact_is_active(state, k); k++) {
        shaft_contact *contact = &state->contacts[state->refined.order[k]];
        contact->force = v3(0, 0, 0);
        contact->slip = 0.0;
    }
    guides_release(state);
    state->tip.force = state->tip.damping = v3(0, 0, 0);
    state->tip.end_force = state->tip.dent = 0.0;
    state->tip.slip = state->tip.shaft_slip = state->tip.stretch = 0.0;
    state->base_shift = v3(0, 0, 0);
    roll_release(state);
}

/* The needle is left out of the solve from the next tick on, until it is drawn back. */
static void buckle(const tick_context *tick) {
    tick->state->buckled = true;
    tick->state->stuck_at = tick->scratch->start.joints[tick->model->needle->given.segments];
}

/* The tick has found no force to answer with. */
static void give_up(const tick_context *tick) {
    equilibrium_release(tick->state);
    buckle(tick);
    tick->output->events |= EVENT_UNSTABLE;
}

/* By Haynsworth's inertia formula: see README.md, "One tick is one convex problem". */
static bool is_saddle(const insertion_workspace *w) { return w->problem.negative < w->tangent.unstable; }

/* A saddle is not stable. One seen before the passes have converged counts if the last tick ended at one, too. */
static void judge_stability(const tick_context *tick, bool converged) {
    bool saddle = is_saddle(tick->scratch);
    if (saddle && (converged || tick->state->saddle)) give_up(tick);
    tick->state->saddle = saddle;
}

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

typedef struct {
    bool found, converged, diverging, buckling;
} pass_result;

/* Newton passes from the present shape. */
static pass_result run_passes(const tick_context *tick, int most) {
    const insertion_model *model = tick->model;
    pass_result r = {.found = true};
    double turned = 0.0, before = 0.0, length = model->needle->given.length, buckling_scale = 20.2 * model->needle->bending / (length * length);
    vec3 push = push_on(tick);
    for (int pass = 0; pass < most && r.found && !r.converged; pass++) {
        before = turned;
        r.found = solve_pass(tick, &turned);
        vec3 now = push_on(tick), more = v3_sub(now, push);
        push = now;
        r.converged = turned * turned * length < model->settings.tolerance && v3_norm(more) < NEW_PUSH * buckling_scale && guides_agree(tick) && stiffening_agrees(tick);
    }
    /* A state from which the passes diverge is no equilibrium. A single pass cannot tell. */
    r.diverging = before > 0.0 && turned > before && turned > DIVERGING;
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
        return (point_solution){.force = state->tip.force, .traction = state->tip.shaft_traction, .slip = state->tip.slip, .friction = state->tip.friction};
    const shaft_contact *contact = &state->contacts[p->handle];
    return (point_solution){.force = contact->force, .traction = contact->traction, .slip = contact->slip, .friction = contact->friction};
}

static void set_solution(insertion_state *state, const contact_point *p, const point_solution *s) {
    *point_force(state, p) = s->force;
    if (p->kind == POINT_GUIDE) {
        guide_contact *face = &state->guides[p->guide].faces[p->face];
        face->slip = s->slip;
        face->friction = s->friction;
        face->touching = s->touching;
    } else if (p->kind == POINT_TIP) {
        state->tip.shaft_traction = s->traction;
        state->tip.slip = s->slip;
        state->tip.friction = s->friction;
    } else {
        shaft_contact *contact = &state->contacts[p->handle];
        contact->traction = s->traction;
        contact->slip = s->slip;
        contact->friction = s->friction;
    }
}

/* Keeps all that the passes change of the points, at the start of the tick. */
static void remember_points(const tick_context *tick) {
    const needle_tip *tip = &tick->state->tip;
    insertion_workspace *w = tick->scratch;
    for (int i = 0; i < w->point_count; i++) w->start_points[i] = solution_at(tick->state, &w->points[i]);
    w->start_tip = (tip_solution){tip->damping, tip->end_force, tip->shaft_slip, tip->shaft_friction};
}

/* How far the gaps differ from those that balance the forces at the start of the tick: the base has moved; a tip at bone has not. */
static void find_lag(const tick_context *tick) {
    insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    contact_problem *p = &w->problem;
    double force[MAX_UNKNOWNS];
    int tip = p->count - 1, all = unknown(p->count, p->count, 2) + w->tip;
    linearise(tick);
    for (int i = 0; i < p->count; i++) {
        vec3 f = m3_apply_transposed(&w->points[i].at.frame, *point_force(state, &w->points[i]));
        force[unknown(p->count, i, 0)] = f.x;
        force[unknown(p->count, i, 1)] = f.y;
        force[unknown(p->count, i, 2)] = f.z;
    }
    if (w->tip) {
        double shaft = state->tip.shaft_traction * (w->points[tip].share.to - w->points[tip].share.from);
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
    state->tip.shaft_slip = w->start_tip.shaft_slip;
    state->tip.shaft_friction = w->start_tip.shaft_friction;
    locate_points(tick);
    load_needle(tick);
}

/* Repeats the tick, closing the gaps in small steps. One large step against bone finds the straight needle, which beyond
   Euler's load is not stable; small steps follow the branch on which it bows. Where that branch ends, the tick ends as well, with the last
   stable equilibrium on the way: the force at which the needle buckled. */
static pass_result approach(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    const double least_step = 1.0 / 256;
    pass_result r = {.found = true};
    recall(tick);
    find_lag(tick);
    for (double done = 0.0, step = 0.25; done < 1.0 && step >= least_step;) {
        w->lag_left = 1.0 - (done + step);
        r = run_passes(tick, tick->model->settings.max_passes);
        bool stable = r.found && r.converged && !is_saddle(w);
        if (stable) remember_shape(tick), remember_points(tick), done += step;
        else recall(tick), step *= 0.5;
        r.buckling = !stable;
    }
    w->lag_left = 0.0;
    if (!r.buckling) return r;
    recall(tick);
    return (pass_result){.found = true, .buckling = true};
}

/* Tissue along an open track springs back over a tip that goes farther than the hand carries it. Beyond that, it has the viscosity of tissue that
   is not open: otherwise nothing would hold what springs back, and the force would fall at once as the tip comes into the track. */
static bool may_spring(const tick_context *tick) {
    const needle_tip *tip = &tick->state->tip;
    return tick->scratch->tip && tip->blocked_by == NOT_BLOCKED && tip->open > 0.0 && isfinite(tick->scratch->tip_carried);
}

/* N s/m, that the open track takes off. */
static double viscosity_lost(const tick_context *tick) {
    const needle_tip *tip = &tick->state->tip;
    return tip->open * tick->model->materials[tick->model->mesh->region[tip->tet]].cutting_viscosity;
}

static bool springs(const tick_context *tick) {
    return viscosity_lost(tick) * (tick->state->tip.slip - tick->scratch->tip_carried) >= LEAST_LOST * tick->dt;
}

/* Checks whether tissue has sprung back. If so, the step is to be solved again with that law. */
static bool set_spring_law(const tick_context *tick) {
    if (tick->scratch->tip_law == TIP_SPRINGS || !may_spring(tick) || !springs(tick)) return false;
    set_tip_law(tick, TIP_SPRINGS, tick->scratch->tip_carried);
    return true;
}

/* What clearly sprang back in the last step as a rule still does: with that law from the start, the step is solved once. */
static bool expect_spring(const tick_context *tick) {
    bool expected = tick->state->tip.springs && may_spring(tick);
    if (expected) set_tip_law(tick, TIP_SPRINGS, tick->scratch->tip_carried);
    return expected;
}

/* Checks whether set_spring_law would have found the same after passes without that law. In these the tip slips farther, by at most what it
   yields to the force that the law adds, and must not come to the end of the track, which is judged first. That is a bound for a definite system, linearised
   here. */
static bool springs_as_expected(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    const needle_tip *tip = &tick->state->tip;
    double farther = fmax(w->tip_compliance, 0.0) * viscosity_lost(tick) / tick->dt * (tip->slip - w->tip_carried);
    return w->problem.negative == 0 && springs(tick) && tip->slip + farther <= tip->open_left;
}

/* Checks whether the slip would take the tip to a membrane or bone that it cannot pierce. If so, the step is to be solved again with the tip stopping
   there: otherwise the rest of the slip would be lost in the next step and push the tissue forward again. */
static bool set_stop_law(const tick_context *tick) {
    const needle_tip *tip = &tick->state->tip;
    insertion_workspace *w = tick->scratch;
    if (tip->blocked_by != NOT_BLOCKED || !(tip->slip > 0.0)) return false;
    double distance = tip->open > 0.0 ? fmin(tip->slip, tip->open_left) : tip->slip;
    stop_ahead stop = find_stop(tick, old_tracks_lead(tip, w->aim), distance);
    if (isinf(stop.way)) return false;
    set_tip_law(tick, TIP_STOPS, stop.way + FACE_CLEARANCE); /* so that it gets there */
    w->stop_resistance = stop.resistance;
    tick->state->tip.friction = STICK;
    return true;
}

/* A needle that buckles there, or for which the passes do not converge, gets there first, and is solved for in the next step. */
static pass_result run_to_stop(const tick_context *tick) {
    int most = tick->model->settings.max_passes;
    insertion_workspace *w = tick->scratch;
    pass_result r = run_passes(tick, most);
    if (r.found && r.converged && !r.diverging && !is_saddle(w)) return r;
    set_tip_law(tick, TIP_CUTS, 0.0);
    recall(tick);
    r = run_passes(tick, most);
    return r.found && set_spring_law(tick) ? run_passes(tick, most) : r;
}

void equilibrium_find(const tick_context *tick, const int handles[4]) {
    insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    w->lag_left = 0.0;
    remember_shape(tick);
    /* A needle that goes on as in the last step often needs only one pass. */
    bool guessed = needle_go_on(tick->model->needle, &state->motion, tick->dt, &state->needle);
    prepare(tick, handles);
    remember_points(tick);
    int most = tick->model->settings.max_passes;
    bool spring = expect_spring(tick);
    pass_result r = run_passes(tick, (guessed || spring) && most > GUESS_PASSES ? GUESS_PASSES : most);
    bool solved = r.found && r.converged && !r.diverging;
    if ((guessed && !solved) || (spring && !(solved && springs_as_expected(tick)))) { /* what was guessed may be to blame */
        set_tip_law(tick, TIP_CUTS, 0.0);
        recall(tick);
        r = run_passes(tick, most);
    }
    for (int i = 0; i < MOST_ENDS && r.found && w->tip && old_tracks_overrun(&state->tip); i++) { /* what is beyond the end resists in this step already: a slip cut off there would be missing in the next one */
        old_tracks_end(tick);
        r = run_passes(tick, most);
    }
    if (r.found && set_spring_law(tick)) r = run_passes(tick, most);
    if (r.found && !r.diverging && w->tip && set_stop_law(tick)) r = run_to_stop(tick);
    bool suspect = !r.found || r.diverging || is_saddle(w);
    state->motion.time = 0.0;
    if (suspect && !state->saddle) r = approach(tick);
    else if (r.converged && !suspect) needle_motion_of(tick->model->needle, &w->start, &state->needle, tick->dt, &state->motion);
    if (r.buckling) buckle(tick);
    else if (r.found && !r.diverging) judge_stability(tick, r.converged);
    else give_up(tick);
    state->tip.springs = w->tip && w->tip_law == TIP_SPRINGS && springs_as_expected(tick);
    if (w->tip && !state->buckled) spring_back(tick);
    roll_solve(tick);
    creep_remember(tick);
    if (w->tip) follow_pressing(&state->tip, &w->points[w->point_count - 1].at, tick->dt);
}
