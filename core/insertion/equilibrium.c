#include "insertion/equilibrium.h"

#include <string.h>

#include "insertion/local_compliance.h"
#include "insertion/shaft.h"
#include "insertion/tip.h"
#include "insertion/prefetch.h"

static const double TIP_FADE = 3e-3;     /* m of depth over which the tip gets its full hold sideways, */
static const double TIP_BITE = 0.05;     /* N, or the force along the needle with which it gets it on the surface; the hold */
static const double LEAST_STIFFNESS = 1e-3; /* N/m, of shaft of which hardly any is in tissue: it has come out of a gap */
static const double BITE_TIME = 20e-3;   /* s, follows that force with this lag: at once, the two would take turns each tick */
static const double NEW_PUSH = 0.05;     /* of Euler's load: a needle pushed by so much more than it was linearised for is linearised again */
static const double DIVERGING = 0.05;    /* rad: passes diverge if the last one turned a segment by more, and by more than the pass before */

/* ---- points and forces ------------------------------------------------------------------------------------------------- */

static void locate_points(const insertion_model *model, const insertion_state *state, insertion_workspace *w) {
    for (int i = 0; i < state->active; i++) {
        w->points[i] = needle_at(model->needle, &state->needle, state->contacts[i].arc);
        w->nominal[i] = state->contacts[i].track;
    }
    if (!w->tip) return;
    w->points[state->active] = needle_at(model->needle, &state->needle, model->needle->given.length);
    w->nominal[state->active] = tip_place(&state->tip);
}

/* Forces of the contacts on the needle's joints. */
static void load_needle(const insertion_model *model, const insertion_state *state, insertion_workspace *w) {
    memset(w->load, 0, (size_t)(model->needle->given.segments + 1) * sizeof *w->load);
    for (int i = 0; i < w->problem.count; i++) {
        vec3 force = i < state->active ? state->contacts[i].force : state->tip.force;
        const needle_point *p = &w->points[i];
        for (int k = 0; k < 3; k++) w->load[p->first + k] = v3_axpy(-p->weights[k], force, w->load[p->first + k]);
    }
}

/* The spring that holds the base gives way to the sum of forces. */
static void shift_base(const insertion_model *model, insertion_state *state, const vec3 *load) {
    if (state->base_compliance == 0.0) return;
    vec3 sum = v3(0, 0, 0), before = state->base_shift;
    for (int j = 0; j <= model->needle->given.segments; j++) sum = v3_add(sum, load[j]);
    state->base_shift = v3_scale(state->base_compliance, sum);
    pose base = state->needle.base;
    base.position = v3_add(base.position, v3_sub(state->base_shift, before));
    needle_hold(model->needle, base, &state->needle);
}

/* ---- compliance of the tissue ------------------------------------------------------------------------------------------ */

/* Compliance of the tissue between the tip and each point. */
static void find_tip_rows(const insertion_state *state, const compliance_snapshot *snapshot, const int handles[4], insertion_workspace *w) {
    const double *weights = state->tip.known_weights;
    mat3 own = {{{0}}};
    for (int c = 0; c < 4; c++) {
        mat3 row = compliance_to_point(snapshot, handles, weights, handles[c]);
        m3_add_scaled(&own, weights[c], &row);
    }
    for (int i = 0; i < state->active; i++) w->tip_row[i] = compliance_to_point(snapshot, handles, weights, i);
    w->tip_row[state->active] = own;
}

/* Local compliances of the points, m/N. Shaft: by its share of length in each region. Tip: sideways as shaft of its share and
   one radius more (its grip fades out at the surface unless it is pressed in); along the needle as a disc under the cutting force,
   beside the shaft next to it. */
static void find_local_compliance(const insertion_model *model, const insertion_state *state, insertion_workspace *w) {
    for (int i = 0; i < state->active; i++) {
        const shaft_contact *contact = &state->contacts[i];
        shaft_resistance shaft = shaft_resistance_of(model, state, w->shares[i], 0.0);
        w->lateral[i] = local_of_share(contact->log_lateral, shaft.lateral, contact->surplus);
        w->axial[i] = local_of_share(contact->log_axial, shaft.axial, contact->surplus);
    }
    if (!w->tip) return;
    int t = state->active;
    const needle_tip *tip = &state->tip;
    double radius = model->needle->radius, depth = tip->depth - tip_entry_depth(state);
    double hold = fmin(1.0, depth / TIP_FADE + tip->pressing / TIP_BITE);
    shaft_resistance shaft = shaft_resistance_of(model, state, w->shares[t], 0.0);
    lateral_axial logarithm = local_logarithm(model, tip->tet, tip->nominal);
    lateral_axial line = local_at(model, tip->tet, tip->nominal);
    w->lateral[t] = logarithm.lateral / (shaft.lateral + radius * logarithm.lateral / line.lateral); /* one radius more */
    w->held_axial = logarithm.axial / (shaft.axial + radius * logarithm.axial / line.axial);
    w->loose = w->lateral[t] * (1.0 / fmax(hold, 1e-6) - 1.0);
    w->axial[t] = local_at_tip(model, tip->tet, tip->nominal, depth, tip->pressing);
    w->axial[t + 1] = logarithm.axial / fmax(shaft.axial, LEAST_STIFFNESS);
}

/* How much farther ahead of the tissue the shaft is because the tissue along its share has become softer (stiffer: less far), under
   the traction that it bears, m. What comes into a share in another region is not yet sheared; without this, the shaft would have to
   slide for it, in the tick in which the tip enters that region. */
static double lead_gained(const insertion_model *model, const insertion_state *state, shaft_share share, double logarithm, double traction, double *softness) {
    shaft_resistance shaft = shaft_resistance_of(model, state, share, 0.0);
    double before = *softness;
    *softness = (share.to - share.from) / fmax(shaft.axial, LEAST_STIFFNESS);
    return before > 0.0 ? logarithm * (*softness - before) * traction : 0.0;
}

static void keep_shear(const insertion_model *model, insertion_state *state, insertion_workspace *w) {
    for (int i = 0; i < state->active; i++) {
        shaft_contact *contact = &state->contacts[i];
        contact->arc += lead_gained(model, state, w->shares[i], contact->log_axial, contact->traction, &contact->softness);
    }
    if (!w->tip) return;
    needle_tip *tip = &state->tip;
    double logarithm = local_logarithm(model, tip->tet, tip->nominal).axial;
    tip->stretch += lead_gained(model, state, w->shares[state->active], logarithm, tip->shaft_traction, &tip->shaft_softness);
}

/* ---- bounds of the forces along the needle ------------------------------------------------------------------------------ */

static void bound_friction(const insertion_model *model, const insertion_state *state, int i, shaft_share share, double slid, friction_state last,
                           double dt, contact_problem *p) {
    shaft_resistance friction = shaft_resistance_of(model, state, share, slid);
    p->upper[i] = friction.dry;
    p->lower[i] = -friction.dry;
    p->viscosity[i][0] = p->viscosity[i][1] = friction.viscous / dt;
    p->state[i] = last;
}

/* The tip bears two forces along the needle: what it cuts, or is stopped by, and friction of the shaft next to it. */
static void bound_tip(const insertion_model *model, const insertion_state *state, shaft_share share, double dt, contact_problem *p) {
    const needle_tip *tip = &state->tip;
    int t = state->active;
    p->upper[t] = tip_resistance(model, tip);
    p->lower[t] = 0.0;
    p->viscosity[t][0] = 0.0;
    p->viscosity[t][1] = tip->blocked_by != NOT_BLOCKED ? 0.0 : model->materials[model->mesh->region[tip->tet]].cutting_viscosity / dt;
    p->state[t] = tip->friction;
    bound_friction(model, state, t + 1, share, tip->shaft_slid + fabs(tip->shaft_slip), tip->shaft_friction, dt, p);
}

static void bound_contacts(const insertion_model *model, const insertion_state *state, double dt, insertion_workspace *w) {
    for (int i = 0; i < state->active; i++) {
        const shaft_contact *contact = &state->contacts[i];
        bound_friction(model, state, i, w->shares[i], contact->slid + fabs(contact->slip), contact->friction, dt, &w->problem);
    }
    if (w->tip) bound_tip(model, state, w->shares[state->active], dt, &w->problem);
}

/* ---- the contact problem ------------------------------------------------------------------------------------------------ */

static mat3 needle_block(const needle_tangent *tangent, const needle_point *p, const needle_point *q) {
    mat3 sum = {{{0}}};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            m3_add_block(&sum, p->weights[i] * q->weights[j], &tangent->compliance[3 * (p->first + i)][3 * (q->first + j)], NEEDLE_LD);
    return sum;
}

/* Unknowns: two sideways for each point, then one along the needle for each, then that of the shaft next to the tip. */
static int unknown(int count, int point, int axis) { return axis < 2 ? 2 * point + axis : 2 * count + point; }

static void put_block(contact_problem *p, int i, int j, const mat3 *compliance, const mat3 *frame_i, const mat3 *frame_j) {
    mat3 half = m3_multiply(compliance, frame_j), turned = m3_transposed(frame_i);
    turned = m3_multiply(&turned, &half);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) {
            int row = unknown(p->count, i, a), column = unknown(p->count, j, b);
            if (row >= column) p->compliance[row][column] = turned.m[a][b];
            else p->compliance[column][row] = turned.m[a][b];
        }
}

/* The shaft next to the tip pulls at the same point along the same line: as yet a copy of the tip's last row and column. */
static void repeat_tip(contact_problem *p) {
    int tip = unknown(p->count, p->count - 1, 2), shaft = tip + 1;
    memcpy(p->compliance[shaft], p->compliance[tip], (size_t)shaft * sizeof **p->compliance);
    p->compliance[shaft][shaft] = p->compliance[tip][tip];
}

/* Local compliance belongs to the tissue: its principal directions are those of the track, not of the needle. If they turned with a
   needle that bends there, the passes would diverge near buckling, because the tangent lacks that term. The shaft next to the tip
   carries what lies sideways with it as a contact would, so that nothing jumps when one takes the place of the other. What the end
   face presses in yields along the needle, under its own force alone. */
static void add_local_compliance(contact_problem *p, const insertion_workspace *w, int point, vec3 track, bool tip) {
    int first = unknown(p->count, point, 0), face = unknown(p->count, point, 2), axial = face + tip;
    const int row[] = {first, first + 1, axial};
    vec3 share = m3_apply_transposed(&w->points[point].frame, track); /* of each force, along the track */
    const double along[] = {share.x, share.y, share.z};
    double shaft = w->axial[point + tip], held = tip ? w->held_axial : shaft; /* held <= shaft: positive semidefinite */
    for (int i = 0; i < 3; i++)
        for (int j = 0; j <= i; j++)
            p->compliance[row[i]][row[j]] += w->lateral[point] * ((i == j) - along[i] * along[j]) + (j == 2 ? shaft : held) * along[i] * along[j];
    if (tip) p->compliance[face][face] += w->axial[point];
}

/* Compliance of tissue, needle and the hold on its base between all points, in their frames; local compliance on the diagonal. */
static void assemble_compliance(insertion_workspace *w, const insertion_state *state, const compliance_snapshot *snapshot) {
    contact_problem *p = &w->problem;
    for (int i = 0; i < p->count; i++)
        for (int j = 0; j <= i; j++) {
            mat3 sum = i == state->active ? w->tip_row[j] : compliance_between(snapshot, i, j);
            mat3 needle = needle_block(&w->tangent, &w->points[i], &w->points[j]);
            m3_add_scaled(&sum, 1.0, &needle);
            for (int a = 0; a < 3; a++) sum.m[a][a] += state->base_compliance;
            put_block(p, i, j, &sum, &w->points[i].frame, &w->points[j].frame);
        }
    if (w->tip) repeat_tip(p);
    for (int i = 0; i < state->active; i++) add_local_compliance(p, w, i, state->contacts[i].direction, false);
    if (!w->tip) return;
    add_local_compliance(p, w, state->active, state->tip.direction, true);
    for (int a = 0; a < 2; a++) p->compliance[2 * state->active + a][2 * state->active + a] += w->loose;
}

/* The gaps that would be open without contact forces. */
static void assemble_gaps(insertion_workspace *w, const insertion_state *state) {
    contact_problem *p = &w->problem;
    for (int i = 0; i < p->count; i++) {
        const needle_point *at = &w->points[i];
        vec3 gap = v3_sub(v3_sub(at->position, state->base_shift), w->nominal[i]);
        for (int k = 0; k < 3; k++) gap = v3_axpy(at->weights[k], w->tangent.drift[at->first + k], gap);
        gap = m3_apply_transposed(&at->frame, gap);
        p->gap[unknown(p->count, i, 0)] = gap.x;
        p->gap[unknown(p->count, i, 1)] = gap.y;
        p->gap[unknown(p->count, i, 2)] = gap.z;
    }
    int shaft = unknown(p->count, p->count, 2);
    if (w->tip) p->gap[shaft] = p->gap[shaft - 1] + state->tip.stretch;
}

/* Where the tip cuts, tissue springs back no faster than a shear wave crosses its dent: a damper at the tip, in parallel with the
   tissue. In a step the dent goes the part 1 - exp(-c dt / dent) of the way to the displacement u that the forces would hold
   statically, c being the wave's speed: dent' = relaxed u + (1 - relaxed) dent. The damper's force on the tissue, (dent' - u) over the
   tip's compliance, is eliminated here. It takes a matrix of rank 1 off the tissue's compliance, which stays positive semidefinite. */
static void damp_tip(insertion_workspace *w, const insertion_state *state) {
    contact_problem *p = &w->problem;
    int t = p->count - 1, tip = unknown(p->count, t, 2), all = tip + 2;
    double *a = w->tip_column;
    vec3 along = state->tip.direction, own = m3_apply(&w->tip_row[t], along);
    double facing = v3_dot(needle_along(&w->points[t]), along);
    for (int i = 0; i < p->count; i++) {
        vec3 moved = m3_apply_transposed(&w->tip_row[i], along);
        moved = m3_apply_transposed(&w->points[i].frame, moved);
        a[unknown(p->count, i, 0)] = moved.x;
        a[unknown(p->count, i, 1)] = moved.y;
        a[unknown(p->count, i, 2)] = moved.z;
    }
    a[tip + 1] = a[tip];
    a[tip] += w->axial[t] * facing;
    w->tip_yield = v3_dot(along, own) + w->axial[t] * facing * facing;
    double held = (1.0 - w->relaxed) / w->tip_yield;
    if (held == 0.0) return;
    for (int i = 0; i < all; i++) {
        for (int j = 0; j <= i; j++) p->compliance[i][j] -= held * a[i] * a[j];
        p->gap[i] -= held * a[i] * state->tip.dent;
    }
}

/* The dent after this step, and the damper's force. */
static void spring_back(insertion_state *state, const insertion_workspace *w) {
    const contact_problem *p = &w->problem;
    int tip = unknown(p->count, p->count - 1, 2);
    double u = 0.0;
    for (int i = 0; i < tip + 2; i++) u += w->tip_column[i] * p->force[i];
    double dent = w->relaxed * u + (1.0 - w->relaxed) * state->tip.dent;
    state->tip.damping = v3_scale((dent - u) / w->tip_yield, state->tip.direction);
    state->tip.dent = dent;
}

static void take_forces(insertion_state *state, const insertion_workspace *w) {
    const contact_problem *p = &w->problem;
    for (int i = 0; i < p->count; i++) {
        bool at_tip = i == state->active;
        double along = p->force[2 * p->count + i] + (at_tip ? p->force[2 * p->count + i + 1] : 0.0);
        vec3 force = m3_apply(&w->points[i].frame, v3(p->force[2 * i], p->force[2 * i + 1], along));
        if (at_tip) {
            state->tip.force = force;
            state->tip.shaft_traction = p->force[2 * p->count + i + 1] / (w->shares[i].to - w->shares[i].from);
            state->tip.slip = p->slip[i];
            state->tip.friction = p->state[i];
            state->tip.shaft_slip = p->slip[i + 1];
            state->tip.shaft_friction = p->state[i + 1];
        } else {
            state->contacts[i].force = force;
            state->contacts[i].traction = along / (w->shares[i].to - w->shares[i].from);
            state->contacts[i].slip = p->slip[i];
            state->contacts[i].friction = p->state[i];
        }
    }
}

/* While the tip sticks, the tissue follows the hand, which is far slower than waves. */
static double tip_relaxed(const insertion_model *model, const needle_tip *tip, double dt) {
    if (tip->friction != SLIP_FORWARD || tip->dent == 0.0) return 1.0;
    return -expm1(-dt * local_wave_speed(model, tip->tet, tip->nominal) / fabs(tip->dent));
}

/* ---- passes ------------------------------------------------------------------------------------------------------------- */

/* Starts from the last solve's shape and forces. */
static void prepare(const insertion_model *model, insertion_state *state, const compliance_snapshot *snapshot, const int handles[4],
                    double dt, insertion_workspace *w) {
    w->problem.count = state->active + w->tip;
    w->problem.axial_count = w->problem.count + w->tip;
    for (int i = 0; i < w->problem.count; i++) w->shares[i] = shaft_share_of(state, i, w->tip);
    if (w->tip) find_tip_rows(state, snapshot, handles, w);
    w->relaxed = w->tip ? tip_relaxed(model, &state->tip, dt) : 1.0;
    keep_shear(model, state, w);
    locate_points(model, state, w);
    find_local_compliance(model, state, w);
    load_needle(model, state, w);
    profile_end_stage(&w->profile, INSERTION_TISSUE);
}

static int first_joint(const insertion_workspace *w) {
    int first = NEEDLE_MAX_SEGMENTS;
    for (int i = 0; i < w->problem.count; i++) first = w->points[i].first < first ? w->points[i].first : first;
    return first;
}

/* Linearises the needle and puts the contact problem together. */
static void linearise(const insertion_model *model, const insertion_state *state, insertion_workspace *w, const compliance_snapshot *snapshot, double dt) {
    needle_linearise(model->needle, &state->needle, w->load, first_joint(w), &w->tangent);
    profile_end_stage(&w->profile, INSERTION_NEEDLE);
    bound_contacts(model, state, dt, w);
    assemble_compliance(w, state, snapshot);
    assemble_gaps(w, state);
    if (w->tip) damp_tip(w, state);
}

/* Linearises the needle, solves the contact problem and turns the needle's segments, by at most `turned` rad. False: there is no
   equilibrium. */
static bool solve_pass(const insertion_model *model, insertion_state *state, insertion_workspace *w, const compliance_snapshot *snapshot, double dt,
                       insertion_wrench *wrench, double *turned) {
    wrench->passes++;
    linearise(model, state, w, snapshot, dt);
    int all = unknown(w->problem.count, w->problem.count, 2) + w->tip;
    for (int i = 0; i < all && w->lag_left > 0.0; i++) w->problem.gap[i] -= w->lag_left * w->lag[i];
    if (contact_solve(&w->problem) != TROCAR_OK) return false;
    wrench->switches += w->problem.switches;
    take_forces(state, w);
    profile_end_stage(&w->profile, INSERTION_CONTACT);
    load_needle(model, state, w);
    shift_base(model, state, w->load);
    *turned = needle_advance(model->needle, &w->tangent, w->load, &state->needle);
    locate_points(model, state, w);
    profile_end_stage(&w->profile, INSERTION_NEEDLE);
    return true;
}

/* No equilibrium: the needle has buckled beyond what the tissue holds. */
void equilibrium_release(insertion_state *state) {
    for (int i = 0; i < state->active; i++) {
        state->contacts[i].force = v3(0, 0, 0);
        state->contacts[i].slip = 0.0;
    }
    state->tip.force = state->tip.damping = v3(0, 0, 0);
    state->tip.dent = 0.0;
    state->tip.slip = state->tip.shaft_slip = state->tip.stretch = 0.0;
    state->base_shift = v3(0, 0, 0);
}

/* From the next tick on the needle takes no part, until it is drawn back. */
static void buckle(const insertion_model *model, insertion_state *state, const insertion_workspace *w) {
    state->buckled = true;
    state->stuck_at = w->start.joints[model->needle->given.segments];
}

/* There is nothing that this tick could give. */
static void give_up(const insertion_model *model, insertion_state *state, const insertion_workspace *w, insertion_wrench *wrench) {
    equilibrium_release(state);
    buckle(model, state, w);
    wrench->events |= EVENT_UNSTABLE;
}

/* By Haynsworth's inertia formula: see README.md, "One tick is one convex problem". */
static bool is_saddle(const insertion_workspace *w) { return w->problem.negative < w->tangent.unstable; }

/* Needle and tissue would not stay at a saddle. Seen on the way to the solution, it counts if it is seen twice. */
static void judge_stability(const insertion_model *model, insertion_state *state, const insertion_workspace *w, bool converged, insertion_wrench *wrench) {
    bool saddle = is_saddle(w);
    if (saddle && (converged || state->saddle)) give_up(model, state, w, wrench);
    state->saddle = saddle;
}

static void follow_pressing(needle_tip *tip, const needle_point *p, double dt) {
    double pressing = fmax(v3_dot(tip->force, needle_along(p)), 0.0);
    tip->pressing += (pressing - tip->pressing) * -expm1(-dt / BITE_TIME);
}

/* Sum of the forces of all points on the tissue, N. */
static vec3 push_on(const insertion_state *state, const insertion_workspace *w) {
    vec3 sum = w->tip ? state->tip.force : v3(0, 0, 0);
    for (int i = 0; i < state->active; i++) sum = v3_add(sum, state->contacts[i].force);
    return sum;
}

typedef struct {
    bool found, converged, diverging, buckling;
} pass_result;

/* Newton passes from the present shape. */
static pass_result run_passes(const insertion_model *model, insertion_state *state, insertion_workspace *w, const compliance_snapshot *snapshot,
                              double dt, int most, insertion_wrench *wrench) {
    pass_result r = {.found = true};
    double turned = 0.0, before = 0.0, length = model->needle->given.length, buckling_scale = 20.2 * model->needle->bending / (length * length);
    vec3 push = push_on(state, w);
    for (int pass = 0; pass < most && r.found && !r.converged; pass++) {
        before = turned;
        r.found = solve_pass(model, state, w, snapshot, dt, wrench, &turned);
        vec3 now = push_on(state, w), more = v3_sub(now, push);
        push = now;
        r.converged = turned * turned * length < model->settings.tolerance && v3_norm(more) < NEW_PUSH * buckling_scale;
    }
    /* A state that the passes run away from is no equilibrium. A single pass cannot tell. */
    r.diverging = before > 0.0 && turned > before && turned > DIVERGING;
    return r;
}

/* Shape and forces at the start of the tick. */
static void remember(const insertion_state *state, insertion_workspace *w) {
    w->start = state->needle;
    for (int i = 0; i < state->active; i++) w->start_force[i] = state->contacts[i].force;
    w->start_force[state->active] = state->tip.force;
    w->start_traction = state->tip.shaft_traction;
}

/* How far the gaps are from what the forces at the start of the tick hold open: the base has moved, and a tip that has met bone has not. */
static void find_lag(const insertion_model *model, insertion_state *state, insertion_workspace *w, const compliance_snapshot *snapshot, double dt) {
    contact_problem *p = &w->problem;
    double force[MAX_UNKNOWNS];
    int tip = state->active, all = unknown(p->count, p->count, 2) + w->tip;
    linearise(model, state, w, snapshot, dt);
    for (int i = 0; i < p->count; i++) {
        vec3 f = m3_apply_transposed(&w->points[i].frame, i < tip ? state->contacts[i].force : state->tip.force);
        force[unknown(p->count, i, 0)] = f.x;
        force[unknown(p->count, i, 1)] = f.y;
        force[unknown(p->count, i, 2)] = f.z;
    }
    if (w->tip) {
        double shaft = state->tip.shaft_traction * (w->shares[tip].to - w->shares[tip].from);
        force[all - 2] -= shaft;
        force[all - 1] = shaft;
    }
    for (int i = 0; i < all; i++) {
        w->lag[i] = p->gap[i];
        for (int j = 0; j < all; j++) w->lag[i] -= (i > j ? p->compliance[i][j] : p->compliance[j][i]) * force[j];
    }
}

/* Back to what was remembered. */
static void recall(const insertion_model *model, insertion_state *state, insertion_workspace *w) {
    state->needle = w->start;
    for (int i = 0; i < state->active; i++) state->contacts[i].force = w->start_force[i];
    state->tip.force = w->start_force[state->active];
    state->tip.shaft_traction = w->start_traction;
    locate_points(model, state, w);
    load_needle(model, state, w);
}

/* The same tick again, with the gaps closed little by little. One large step against bone finds the straight needle, which beyond
   Euler's load is no stable equilibrium; small ones follow the branch on which it bows. Where that ends, the tick does, too: with the last
   stable equilibrium on the way, as the force at which the needle buckled. */
static pass_result approach(const insertion_model *model, insertion_state *state, insertion_workspace *w, const compliance_snapshot *snapshot,
                            double dt, insertion_wrench *wrench) {
    const double least_step = 1.0 / 256;
    pass_result r = {.found = true};
    recall(model, state, w);
    find_lag(model, state, w, snapshot, dt);
    for (double done = 0.0, step = 0.25; done < 1.0 && step >= least_step;) {
        w->lag_left = 1.0 - (done + step);
        r = run_passes(model, state, w, snapshot, dt, model->settings.max_passes, wrench);
        bool stable = r.found && r.converged && !is_saddle(w);
        if (stable) remember(state, w), done += step;
        else recall(model, state, w), step *= 0.5;
        r.buckling = !stable;
    }
    w->lag_left = 0.0;
    if (!r.buckling) return r;
    recall(model, state, w);
    return (pass_result){.found = true, .buckling = true};
}

void equilibrium_find(const insertion_model *model, insertion_state *state, insertion_workspace *w, const compliance_snapshot *snapshot,
                      const int handles[4], double dt, insertion_wrench *wrench) {
    w->lag_left = 0.0;
    prepare(model, state, snapshot, handles, dt, w);
    remember(state, w);
    pass_result r = run_passes(model, state, w, snapshot, dt, model->settings.max_passes, wrench);
    bool suspect = !r.found || r.diverging || is_saddle(w);
    if (suspect && !state->saddle) r = approach(model, state, w, snapshot, dt, wrench);
    if (r.buckling) buckle(model, state, w);
    else if (r.found && !r.diverging) judge_stability(model, state, w, r.converged, wrench);
    else give_up(model, state, w, wrench);
    if (w->tip && !state->buckled) spring_back(state, w);
    if (w->tip) follow_pressing(&state->tip, &w->points[state->active], dt);
}
