#include "insertion/derivatives/tick_derivatives.h"

#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "insertion/contact/roll.h"
#include "insertion/derivatives/needle_influence.h"
#include "insertion/derivatives/tissue_parameters.h"
#include "insertion/guide/guides.h"
#include "insertion/laws/along_track.h"
#include "insertion/step/passes.h"

enum { MOST_ROWS = MAX_UNKNOWNS + 2 * MAX_POINTS };

/* The linear system. Its unknowns are the derivatives of the contact problem's forces, in the points' frames, then those of the points' tangents, two per
   point. A point's frame turns with its tangent, and the force turns with the frame (turned_force). */
typedef struct {
    int variables;
    needle_influence needle;
    point_forces forces;
    double response[MAX_UNKNOWNS][2 * MAX_POINTS];   /* m: derivative of each gap with respect to each tangent; the force at that point turns with the
                                                        tangent */
    double matrix[MOST_ROWS * MOST_ROWS];            /* column-major */
    double side[MAX_VARIABLES][MOST_ROWS];           /* right-hand sides, then the solution */
    double gap[MAX_VARIABLES][MAX_UNKNOWNS];         /* m: derivative of each gap with respect to each variable, with forces and tangents fixed */
    lapack_int pivots[MOST_ROWS];
} linear_system;

/* ---- the contact problem ------------------------------------------------------------------------------------------------- */

/* The law of a force along the needle: the contact sticks, or the force grows with the slip at the rate `viscosity`. */
typedef struct {
    bool sticks;
    double viscosity;        /* N/m */
    double slip;             /* m, slip left until the law changes */
    double force;            /* N, change in force left until the law changes; only if the contact sticks */
    int piece;               /* piece of the staircase on which the tip slides; -1 otherwise */
} axial_law;

/* Returns the law of the force on the tip's end face, which follows the staircase. */
static axial_law law_of_climber(const contact_problem *p, int i, double force) {
    const staircase *s = &p->ahead;
    int k = p->knot < s->count ? p->knot : s->count - 1, below = k - 1, piece = p->state[i] == SLIP_FORWARD ? k : below;
    double end = k > 0 ? s->level[below] + s->slope[below] * (s->at[k] - s->at[below]) : s->back;
    double beyond = piece + 1 < s->count ? s->at[piece + 1] : INFINITY;
    axial_law law = {.sticks = p->state[i] == STICK, .force = smaller_of(s->level[k] - force, force - end), .piece = -1};
    if (!law.sticks && piece >= 0) law.viscosity = s->slope[piece], law.piece = piece;
    law.slip = smaller_of(fabs(p->slip[i] - s->at[k]), piece >= 0 ? fabs((piece == k ? beyond : s->at[piece]) - p->slip[i]) : INFINITY);
    return law;
}

/* Returns how fast the friction along the needle decreases with the slip (N/m): the friction limit falls while the shaft's surface slides. If the shaft also
   turns, only part of slip and friction is along the needle; roll_bound_for_sliding accounts for how that part changes. */
static double weakening(const tick_input *tick, const insertion_state *state, const contact_point *point, double slip) {
    double distance = tick->model->settings.weakening_distance, along = part_along(tick, state, point, slip);
    return along * along * point->shaft.excess / distance * exp(-slid_distance(tick, state, point) / distance);
}

static axial_law law_of(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, int row, double force) {
    const contact_problem *p = &w->problem;
    int i = row - 2 * p->count, point = point_of_unknown(p->count, row);
    if (p->ahead.count > 0 && i == p->climber) return law_of_climber(p, i, force);
    axial_law law = {.sticks = p->state[i] == STICK && p->upper[i] > p->lower[i], .slip = fabs(p->slip[i]), .piece = -1};
    law.force = smaller_of(p->upper[i] - force, force - p->lower[i]);
    if (law.sticks || point < w->points.guided) return law;
    law.viscosity = p->viscosity[i][p->state[i] == SLIP_FORWARD] - weakening(tick, state, &w->points.list[point], p->slip[i]);
    return law;
}

/* Returns the force (N) of unknown `row` along the needle. */
static double axial_force(const linear_system *s, const contact_problem *p, const contact_points *points, int row) {
    int i = row - 2 * p->count;
    if (points->tip && i >= p->count - 1) return i == p->count ? s->forces.shaft : s->forces.face;
    return s->forces.at[i][2];
}

/* ---- turning frames -------------------------------------------------------------------------------------------------------- */

/* Returns the derivative of a force's component along `axis` of its frame with respect to the tangent's component along axis a. */
static double turned_force(const double force[3], int axis, int a) { return axis == 2 ? -force[a] : axis == a ? force[2] : 0.0; }

/* Returns the derivative, with respect to the tangent at point j along axis a, of a weighted sum of the components of the force there. `across`, `along`:
   weights of the components across and along the needle. At the tip, the forces along the needle on the end face and on the shaft are separate unknowns, with
   the weights along[0] and along[1]. A lateral force that turns adds to both, in the fractions in which it acts on them. */
static double turned_sum(const linear_system *s, const insertion_workspace *w, int j, int a, const double across[2], const double along[2]) {
    double on_shaft = w->points.list[j].kind == POINT_TIP ? w->tissue.sideways_on_shaft : 0.0;
    double sum = turned_force(s->forces.at[j], 2, a) * ((1.0 - on_shaft) * along[0] + on_shaft * along[1]);
    for (int axis = 0; axis < 2; axis++) sum += across[axis] * turned_force(s->forces.at[j], axis, a);
    return sum;
}

/* Returns the derivative of the gap `row` with respect to the tangent at point j along axis a; the force at j turns with the tangent. */
static double gap_by_turning(const linear_system *s, const insertion_workspace *w, int row, int j, int a) {
    const contact_problem *p = &w->problem;
    bool tip = w->points.list[j].kind == POINT_TIP;
    int x = unknown(p->count, j, 0), z = unknown(p->count, j, 2);
    double across[2] = {compliance_of(p, row, x), compliance_of(p, row, x + 1)};
    const double along[2] = {compliance_of(p, row, z), tip ? compliance_of(p, row, z + 1) : 0.0};
    if ((row == x || row == x + 1) && j >= w->points.guided) across[row - x] -= w->tissue.extra_lateral_compliance[j]; /* this compliance turns with the
                                                                                                                          frame */
    return turned_sum(s, w, j, a, across, along);
}

/* Returns how far (m) the local compliances move the tissue at the tip's end face sideways, relative to the tissue at the adjacent shaft. */
static void part_at_tip(const linear_system *s, const insertion_state *state, const insertion_workspace *w, double parted[2]) {
    int t = w->points.count - 1;
    double on_shaft = w->tissue.sideways_on_shaft, face = w->tissue.axial[t], shaft = w->tissue.axial[t + 1];
    const principal_tensor *lateral = &w->tissue.lateral[t];
    const mat3 *frame = &w->points.list[t].at.frame;
    vec3 track = m3_apply_transposed(frame, state->tip.place.direction), easy = m3_apply_transposed(frame, lateral->easy);
    vec3 force = v3(on_shaft * s->forces.at[t][0], on_shaft * s->forces.at[t][1], s->forces.shaft);
    vec3 local = v3_axpy(lateral->more * v3_dot(easy, force), easy, v3_axpy((shaft - lateral->least) * v3_dot(track, force), track, v3_scale(lateral->least, force)));
    parted[0] = face * (1.0 - on_shaft) * s->forces.at[t][0] - local.x;
    parted[1] = face * (1.0 - on_shaft) * s->forces.at[t][1] - local.y;
}

/* Each of the tip's forces across the needle is one unknown, of which fixed fractions act on the shaft and on the end face. But when the tip's forces along the
   needle turn with the tangent, each stays on the shaft or on the end face. This adds the resulting difference to the tip's gaps. */
static void turn_tip(const insertion_state *state, const insertion_workspace *w, linear_system *s) {
    int t = w->points.count - 1;
    const principal_tensor *lateral = &w->tissue.lateral[t];
    const track_shares at = along_track(state, &w->points, &w->tissue, t);
    double face = w->tissue.axial[t] + w->stiffening.end.slope, shaft = w->tissue.axial[t + 1];
    /* N per rad: lateral force that a rotation moves from the end face to the shaft */
    double more = (1.0 - w->tissue.sideways_on_shaft) * s->forces.shaft - w->tissue.sideways_on_shaft * s->forces.face;
    vec3 aside = m3_apply_transposed(&w->points.list[t].at.frame, lateral->easy);
    const double easy[] = {aside.x, aside.y, aside.z, aside.z};
    for (int i = 0; i < at.count; i++)
        for (int a = 0; a < 2; a++) {
            double same = at.axis[i] == a, around_shaft = lateral->least * same + (shaft - lateral->least) * at.along[i] * at.along[a] + lateral->more * easy[i] * easy[a];
            s->response[at.row[i]][2 * t + a] += more * (at.on_shaft[i] * around_shaft - at.on_face[i] * face * same);
        }
}

/* In a frame that turns, the components of the gap vector change: its component across the needle (m) enters the gap along the needle, and the slip enters the
   gaps across it. */
static void add_turning_gaps(const insertion_state *state, const insertion_workspace *w, linear_system *s) {
    const contact_problem *p = &w->problem;
    for (int i = w->points.guided; i < p->count; i++) {
        bool tip = w->points.list[i].kind == POINT_TIP;
        double on_shaft = w->tissue.sideways_on_shaft, parted[2] = {0.0}, extra = w->tissue.extra_lateral_compliance[i];
        double slip = tip ? (1.0 - on_shaft) * p->slip[i] + on_shaft * p->slip[i + 1] : p->slip[i] - w->points.list[i].lead;
        if (tip) part_at_tip(s, state, w, parted);
        for (int a = 0; a < 2; a++) {
            int along = unknown(p->count, i, 2);
            s->response[unknown(p->count, i, a)][2 * i + a] += slip;
            s->response[along][2 * i + a] -= extra * s->forces.at[i][a] - (tip ? on_shaft * parted[a] : 0.0);
            if (tip) s->response[along + 1][2 * i + a] -= extra * s->forces.at[i][a] + (1.0 - on_shaft) * parted[a];
        }
    }
}

static void find_response(const insertion_state *state, const insertion_workspace *w, linear_system *s) {
    const contact_problem *p = &w->problem;
    for (int row = 0; row < unknown_count(p); row++)
        for (int j = 0; j < p->count; j++)
            for (int a = 0; a < 2; a++) s->response[row][2 * j + a] = gap_by_turning(s, w, row, j, a);
    add_turning_gaps(state, w, s);
    if (w->points.tip) turn_tip(state, w, s);
}

/* ---- moving the base -------------------------------------------------------------------------------------------------------- */

static vec3 unit_vector(int axis) { return v3(axis == 0, axis == 1, axis == 2); }

/* Returns the displacement of a point that moves rigidly with the base, per unit of a variable (m or rad). */
static vec3 carried(const insertion_state *state, int variable, vec3 x) {
    vec3 axis = unit_vector(variable % 3);
    if (variable >= BASE_VARIABLES) return v3(0, 0, 0);
    return variable < 3 ? axis : v3_cross(axis, v3_sub(x, state->needle.base.position));
}

/* Returns the derivative of a direction that turns with the base. */
static vec3 turned(int variable, vec3 direction) {
    return variable < 3 || variable >= BASE_VARIABLES ? v3(0, 0, 0) : v3_cross(unit_vector(variable % 3), direction);
}

/* Computes the derivative of the forces on the needle as seen from a frame that turns with the base, if the forces themselves do not turn. The components are
   in the points' frames. */
static void turn_loads(const insertion_state *state, const contact_points *points, int variable, double load[POINT_AXES]) {
    for (int j = 0; j < points->count; j++) {
        vec3 change = m3_apply_transposed(&points->list[j].at.frame, turned(variable, point_force(state, &points->list[j])));
        load[3 * j] = change.x, load[3 * j + 1] = change.y, load[3 * j + 2] = change.z;
    }
}

static double product(int count, const double *a, const double *b) {
    double sum = 0.0;
    for (int i = 0; i < count; i++) sum += a[i] * b[i];
    return sum;
}

static void move_base(const insertion_state *state, const insertion_workspace *w, int variable, linear_system *s) {
    const contact_problem *p = &w->problem;
    double load[POINT_AXES];
    int rows = unknown_count(p), axes = 3 * p->count;
    turn_loads(state, &w->points, variable, load);
    for (int row = 0; row < rows; row++) {
        int i = point_of_unknown(p->count, row), axis = axis_of_unknown(p->count, row);
        const needle_point *at = &w->points.list[i].at;
        vec3 moved = m3_apply_transposed(&at->frame, carried(state, variable, at->position));
        const double rigid[3] = {moved.x, moved.y, moved.z};
        s->gap[variable][row] = guides_is_open(&w->points, w->edges, i) ? 0.0 : rigid[axis] + product(axes, s->needle.moved[3 * i + axis], load);
    }
    for (int i = 0; i < p->count; i++) {
        const needle_point *at = &w->points.list[i].at;
        vec3 change = m3_apply_transposed(&at->frame, turned(variable, needle_along(at)));
        s->side[variable][rows + 2 * i] = change.x + product(axes, s->needle.turned[2 * i], load);
        s->side[variable][rows + 2 * i + 1] = change.y + product(axes, s->needle.turned[2 * i + 1], load);
    }
}

/* ---- the system ------------------------------------------------------------------------------------------------------------ */

static double *entry(linear_system *s, int order, int row, int column) { return &s->matrix[(size_t)column * (size_t)order + (size_t)row]; }

/* Adds the equation that the gap stays closed, multiplied by `factor`. */
static void close_gap(const insertion_workspace *w, linear_system *s, int order, int row, double factor) {
    const contact_problem *p = &w->problem;
    int rows = unknown_count(p);
    for (int c = 0; c < rows; c++) *entry(s, order, row, c) += factor * compliance_of(p, row, c);
    for (int c = 0; c < 2 * p->count; c++) *entry(s, order, row, rows + c) += factor * s->response[row][c];
    for (int v = 0; v < s->variables; v++) s->side[v][row] += factor * s->gap[v][row];
}

/* Adds the change in friction on a guide hole's edge, which is proportional to the force across the needle. */
static void follow_edge(const tick_input *tick, const insertion_workspace *w, linear_system *s, int order, int row) {
    const contact_problem *p = &w->problem;
    int i = row - 2 * p->count;
    if (i >= w->points.guided || p->state[i] == STICK || !(w->edges[i].rubbing > 0.0)) return;
    double friction = (int)p->state[i] * tick->model->guides[w->points.list[i].guide].friction / w->edges[i].rubbing;
    for (int a = 0; a < 2; a++) *entry(s, order, row, 2 * i + a) -= friction * s->forces.at[i][a];
}

/* Adds the change in the work against the growing lateral support near the surface, which the cutting force has to do as well (bound_contacts). */
static void follow_support(const insertion_workspace *w, linear_system *s, int order, int row) {
    for (int i = w->points.guided; i < w->points.count; i++)
        for (int a = 0; a < 2; a++) *entry(s, order, row, 2 * i + a) -= w->tissue.tightening[i] * s->forces.at[i][a];
}

/* Adds the equation of a sliding contact: the force along the needle changes by the viscosity times the change in the gap, plus the direct effect of the
   parameters. */
static void follow_law(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, const tick_derivatives *wanted, linear_system *s,
                       int order, int row, const axial_law *law) {
    *entry(s, order, row, row) = 1.0;
    for (int v = 0; v < s->variables; v++) s->side[v][row] = v < BASE_VARIABLES ? 0.0 : resistance_change(tick, state, w, &wanted->parameters[v - BASE_VARIABLES], row, law->piece);
    close_gap(w, s, order, row, law->viscosity);
    follow_edge(tick, w, s, order, row);
    if (law->piece >= 0 && law->viscosity > 0.0) follow_support(w, s, order, row);
}

/* Adds the equations of the tangents, which turn as the forces on the needle change. */
static void turn_tangents(const insertion_workspace *w, linear_system *s, int order) {
    const contact_problem *p = &w->problem;
    int rows = unknown_count(p);
    for (int i = 0; i < 2 * p->count; i++) {
        for (int c = 0; c < rows; c++) *entry(s, order, rows + i, c) = s->needle.turned[i][3 * point_of_unknown(p->count, c) + axis_of_unknown(p->count, c)];
        for (int j = 0; j < p->count; j++)
            for (int a = 0; a < 2; a++) {
                double sum = i == 2 * j + a;
                for (int axis = 0; axis < 3; axis++) sum += s->needle.turned[i][3 * j + axis] * turned_force(s->forces.at[j], axis, a);
                *entry(s, order, rows + i, rows + 2 * j + a) = sum;
            }
    }
}

static bool solve(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, const tick_derivatives *wanted, linear_system *s) {
    const contact_problem *p = &w->problem;
    int rows = unknown_count(p), order = rows + 2 * p->count;
    for (int i = 0; i < order * order; i++) s->matrix[i] = 0.0;
    for (int row = 0; row < rows; row++) {
        axial_law law = {.sticks = true};
        for (int v = 0; v < s->variables; v++) s->side[v][row] = 0.0;
        if (row >= 2 * p->count) law = law_of(tick, state, w, row, axial_force(s, p, &w->points, row));
        if (law.sticks) close_gap(w, s, order, row, 1.0);
        else follow_law(tick, state, w, wanted, s, order, row, &law);
    }
    turn_tangents(w, s, order);
    return LAPACKE_dgesv_work(LAPACK_COL_MAJOR, order, s->variables, s->matrix, order, s->pivots, s->side[0], MOST_ROWS) == 0;
}

/* ---- results --------------------------------------------------------------------------------------------------------------- */

/* Computes the derivatives of the forces on tissue and guides, in the points' frames (N). */
static void change_forces(const insertion_workspace *w, const linear_system *s, const double *solution, double change[POINT_AXES]) {
    const contact_problem *p = &w->problem;
    int rows = unknown_count(p);
    for (int i = 0; i < 3 * p->count; i++) change[i] = 0.0;
    for (int row = 0; row < rows; row++) change[3 * point_of_unknown(p->count, row) + axis_of_unknown(p->count, row)] += solution[row];
    for (int j = 0; j < p->count; j++)
        for (int axis = 0; axis < 3; axis++)
            for (int a = 0; a < 2; a++) change[3 * j + axis] += turned_force(s->forces.at[j], axis, a) * solution[rows + 2 * j + a];
}

static vec3 to_world(const contact_points *points, int i, const double *change) {
    return m3_apply(&points->list[i].at.frame, v3(change[3 * i], change[3 * i + 1], change[3 * i + 2]));
}

/* Returns the derivative of the damper's force (N, world frame) on the tissue at the tip. */
static vec3 change_damping(const insertion_state *state, const insertion_workspace *w, const linear_system *s, const double *solution) {
    const contact_problem *p = &w->problem;
    const double *column = w->damper.column;
    int rows = unknown_count(p);
    double dent = product(rows, column, solution);
    for (int i = 0; i < 2 * p->count; i++) {
        int z = unknown(p->count, i / 2, 2);
        const double along[2] = {column[z], w->points.list[i / 2].kind == POINT_TIP ? column[z + 1] : 0.0};
        dent += turned_sum(s, w, i / 2, i % 2, &column[i / 2 * 2], along) * solution[rows + i];
    }
    return v3_scale(-(1.0 - w->damper.relaxed) * dent / w->damper.yield, state->tip.place.direction);
}

/* Computes the derivatives of the forces that displace the nominal mesh as much as the needle does. */
static void find_loads(const insertion_state *state, const insertion_workspace *w, const linear_system *s, const double *solution, const double *change,
                       variable_derivatives *to) {
    for (int i = 0; i < w->points.count; i++)
        to->load[i] = i < w->points.guided ? v3(0, 0, 0) : v3_scale(w->creep.yield, to_world(&w->points, i, change));
    int t = w->points.count - 1;
    if (w->points.tip) to->load[t] = v3_axpy(w->creep.yield, change_damping(state, w, s, solution), to->load[t]);
}

static void find_wrench(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, const linear_system *s, int variable,
                        const double *change, variable_derivatives *to) {
    const contact_points *points = &w->points;
    double load[POINT_AXES], shift = tick->base.compliance;
    int axes = 3 * points->count;
    vec3 sum = v3(0, 0, 0), end = carried(state, variable, state->needle.joints[tick->model->needle->given.segments]);
    to->direction = turned(variable, needle_end_direction(tick, &state->needle));
    turn_loads(state, points, variable, load);
    for (int i = 0; i < axes; i++) {
        load[i] -= change[i];
        end = v3_axpy(load[i], s->needle.end[i], end);
        to->direction = v3_axpy(load[i], s->needle.end_turned[i], to->direction);
    }
    to->torque = v3(0, 0, 0);
    for (int i = 0; i < points->count; i++) {
        const needle_point *at = &points->list[i].at;
        vec3 force = to_world(points, i, change), lever = v3_sub(at->position, state->needle.base.position);
        double moved[3];
        for (int a = 0; a < 3; a++) moved[a] = product(axes, s->needle.moved[3 * i + a], load);
        vec3 relative = v3_add(turned(variable, lever), m3_apply(&at->frame, v3(moved[0], moved[1], moved[2])));
        to->torque = v3_sub(to->torque, v3_add(v3_cross(relative, point_force(state, &points->list[i])), v3_cross(lever, force)));
        sum = v3_add(sum, force);
    }
    to->force = v3_scale(-1.0, sum);
    to->tip = v3_axpy(-shift, sum, end);
}

/* Adds the change in the torque about the needle's axis. The torque turns with the axis and depends on the base's roll. */
static void add_roll(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, int variable, double torque, variable_derivatives *to) {
    vec3 axis = q_axis(state->needle.base.orientation);
    double rolled = variable < 3 || variable >= BASE_VARIABLES ? 0.0 : v3_dot(unit_vector(variable % 3), axis);
    to->torque = v3_axpy(-torque, turned(variable, axis), to->torque);
    to->torque = v3_axpy(-rolled * roll_stiffness(tick, state, &w->points, &w->creep), axis, to->torque);
}

/* Returns the change in the variable at which this contact would switch. */
static double switches_at(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, const linear_system *s, int row, int variable) {
    const contact_problem *p = &w->problem;
    const double *solution = s->side[variable];
    int rows = unknown_count(p);
    axial_law law = law_of(tick, state, w, row, axial_force(s, p, &w->points, row));
    if (law.sticks) return law.force / fabs(solution[row]);
    double slip = s->gap[variable][row];
    for (int c = 0; c < rows; c++) slip -= compliance_of(p, row, c) * solution[c];
    slip -= product(2 * p->count, s->response[row], solution + rows);
    return law.slip / fabs(slip);
}

static double range_of(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, const linear_system *s, int variable) {
    const contact_problem *p = &w->problem;
    double least = INFINITY;
    for (int row = 2 * p->count; row < unknown_count(p); row++)
        /* an unknown that does not change gives 0 / 0 = NaN, which fmin ignores */
        if (!guides_is_open(&w->points, w->edges, point_of_unknown(p->count, row))) least = fmin(least, switches_at(tick, state, w, s, row, variable));
    return larger_of(least, 0.0);
}

static void differentiate_free(const tick_input *tick, const insertion_state *state, tick_derivatives *derivatives) {
    for (int v = 0; v < derivatives->count; v++)
        derivatives->of[v] = (variable_derivatives){.tip = carried(state, v, state->needle.joints[tick->model->needle->given.segments]), .range = INFINITY,
                                                    .direction = turned(v, needle_end_direction(tick, &state->needle))};
}

/* Undoes what equilibrium_find and tip_puncture changed after the passes, because the equilibrium depends on the values that held during them:
   the tip's place and filtered push, and the shaft's rotation at each point (sliding and turning share one friction bound). */
static void undo_conclusion(const insertion_workspace *w, insertion_state *state) {
    const pass_checkpoint *start = &w->start;
    for (int i = w->points.guided; i < w->points.count; i++) {
        const contact_point *p = &w->points.list[i];
        shaft_hold *shaft = p->kind == POINT_TIP ? &state->tip.shaft : &state->contacts[p->handle].shaft;
        const roll_friction *before = p->kind == POINT_TIP ? &start->tip.shaft.roll : &start->contacts[i].shaft.roll;
        shaft->roll.turned = before->turned;
        shaft->roll.torque = before->torque;
    }
    if (!w->points.tip) return;
    state->tip.place = start->tip.place;
    state->tip.filtered_push = start->tip.filtered_push;
}

/* Differentiates the equilibrium, working on copies of the workspace and of the state as it was during the passes. `torque` (N m): torque on the tissue about
   the needle's axis. Returns false if the system is singular. */
static bool differentiate(const tick_input *tick, const insertion_state *state, double torque, insertion_workspace *w, linear_system *s, tick_derivatives *derivatives) {
    passes_linearise(tick, state, w, true);
    needle_influence_find(tick, w, &s->needle);
    s->forces = point_forces_of(state, &w->points);
    find_response(state, w, s);
    s->variables = derivatives->count;
    for (int v = 0; v < s->variables; v++) move_base(state, w, v, s);
    for (int v = BASE_VARIABLES; v < s->variables; v++) {
        int i = v - BASE_VARIABLES;
        if (derivatives->parameters[i].property == YOUNGS_MODULUS && !stiffen(tick, state, w, &s->forces, derivatives->parameters[i].region, derivatives->moved[i], s->gap[v])) return false;
    }
    if (!solve(tick, state, w, derivatives, s)) return false;
    for (int v = 0; v < s->variables; v++) {
        double change[POINT_AXES];
        change_forces(w, s, s->side[v], change);
        find_loads(state, w, s, s->side[v], change, &derivatives->of[v]);
        find_wrench(tick, state, w, s, v, change, &derivatives->of[v]);
        add_roll(tick, state, w, v, torque, &derivatives->of[v]);
        if (v < BASE_VARIABLES) derivatives->of[v].range = state->moving_on ? 0.0 : range_of(tick, state, w, s, v);
    }
    return true;
}

trocar_status insertion_differentiate(const tick_input *tick, const insertion_state *state, const insertion_workspace *workspace, tick_derivatives *derivatives, trocar_error *why) {
    differentiate_free(tick, state, derivatives);
    if (workspace->points.count == 0) return TROCAR_OK;
    insertion_workspace *w = aligned_alloc(_Alignof(insertion_workspace), sizeof *w);
    linear_system *s = malloc(sizeof *s);
    insertion_state *passes = malloc(sizeof *passes);
    trocar_status status = w && s && passes ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for derivatives");
    if (status == TROCAR_OK) {
        memcpy(w, workspace, sizeof *w);
        memcpy(passes, state, sizeof *passes);
        undo_conclusion(w, passes);
        w->profile.clock = NULL;
        if (!differentiate(tick, passes, roll_torque(state, &w->points), w, s, derivatives))
            status = fail(why, TROCAR_NUMERIC, "the equilibrium is at a limit of stability, where it has no derivative");
    }
    free(w);
    free(s);
    free(passes);
    return status;
}
