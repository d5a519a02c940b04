/* The needle as a geometrically exact Kirchhoff rod: a chain of rigid segments with elastic joints between them. */
#include "needle/needle_kind.h"

#include <stdbool.h>
#include <string.h>

#include "base/row_matrix.h"

static void place_joints(const needle_model *model, needle_state *state) {
    state->joints[0] = state->base.position;
    for (int k = 0; k < model->given.segments; k++)
        state->joints[k + 1] = v3_axpy(model->segment_length, q_axis(state->frames[k]), state->joints[k]);
}

static void rod_rest(const needle_model *model, pose base, needle_state *state) {
    state->base = base;
    for (int k = 0; k < model->given.segments; k++) state->frames[k] = base.orientation;
    place_joints(model, state);
}

/* No load twists the rod, so that every segment turns about its own axis by as much as the base does. */
static void rod_hold(const needle_model *model, pose base, needle_state *state) {
    double roll = q_roll_between(state->base.orientation, base.orientation);
    quat turn = q_exp(v3(0, 0, roll));
    for (int k = 0; k < model->given.segments && roll != 0.0; k++) state->frames[k] = q_unit(q_multiply(state->frames[k], turn));
    state->base = base;
    place_joints(model, state);
}

/* ---- elasticity of the joints -------------------------------------------------------------------------------------- */

/* Joint k precedes segment k. The joint at the base represents half a segment of bending length, the others one segment. */
static double joint_length(const needle_model *model, int k) { return (k == 0 ? 0.5 : 1.0) * model->segment_length; }

static vec3 joint_curvature(const needle_state *state, int k) {
    quat before = k == 0 ? state->base.orientation : state->frames[k - 1];
    return q_log(q_multiply(q_conjugate(before), state->frames[k]));
}

/* Inverse of the right Jacobian of SO(3): rate of the rotation vector w per body rotation (Sola et al. 2018, eq. 144). */
static row_matrix inverse_right_jacobian(vec3 w) {
    double angle2 = v3_dot(w, w), c;
    if (angle2 < 1e-2) {
        c = 1.0 / 12 + angle2 * (1.0 / 720 + angle2 * (1.0 / 30240 + angle2 / 1209600)); /* to 1e-15 */
    } else {
        double angle = sqrt(angle2);
        c = 1.0 / angle2 - (1.0 + cos(angle)) / (2.0 * angle * sin(angle));
    }
    double own = 1.0 - c * angle2;
    lanes v = {w.x, w.y, w.z, 0.0};
    return (row_matrix){{c * w.x * v + (lanes){own, -0.5 * w.z, 0.5 * w.y, 0.0},
                         c * w.y * v + (lanes){0.5 * w.z, own, -0.5 * w.x, 0.0},
                         c * w.z * v + (lanes){-0.5 * w.y, 0.5 * w.x, own, 0.0}}};
}

static inline lanes lanes_of(vec3 v) { return (lanes){v.x, v.y, v.z, 0.0}; }

/* Spatial moment of joint k and its stiffness against the relative spatial rotation of its two segments. */
static vec3 joint_stiffness(const needle_model *model, const needle_state *state, int k, row_matrix *stiffness) {
    double length = joint_length(model, k), bending = model->bending / length, torsion = model->torsion / length;
    vec3 w = joint_curvature(state, k);
    quat frame = state->frames[k];
    row_matrix axes = {{lanes_of(q_axis_x(frame)), lanes_of(q_axis_y(frame)), lanes_of(q_axis(frame))}};
    row_matrix turned = rm_multiply(inverse_right_jacobian(w), axes);
    row_matrix resisted = {{bending * turned.row[0], bending * turned.row[1], torsion * turned.row[2]}};
    lanes moment = w.x * resisted.row[0] + w.y * resisted.row[1] + w.z * resisted.row[2];
    *stiffness = rm_multiply_transposed(turned, resisted);
    return v3(moment[0], moment[1], moment[2]);
}

static vec3 rod_root_moment(const needle_model *model, const needle_state *state) {
    row_matrix unused;
    return joint_stiffness(model, state, 0, &unused);
}

static double rod_energy(const needle_model *model, const needle_state *state) {
    double energy = 0.0;
    for (int k = 0; k < model->given.segments; k++) {
        vec3 w = joint_curvature(state, k);
        energy += 0.5 / joint_length(model, k) * (model->bending * (w.x * w.x + w.y * w.y) + model->torsion * w.z * w.z);
    }
    return energy;
}

/* ---- tangent ------------------------------------------------------------------------------------------------------- */

/* Second variation of -N.t under spatial rotations of a segment (N: sum of the forces beyond it times its length). */
static row_matrix geometric_stiffness(vec3 n, vec3 t) {
    double along = v3_dot(n, t);
    lanes a = -0.5 * lanes_of(n), b = lanes_of(t);
    return (row_matrix){{a[0] * b + b[0] * a + (lanes){along, 0.0, 0.0, 0.0}, a[1] * b + b[1] * a + (lanes){0.0, along, 0.0, 0.0},
                         a[2] * b + b[2] * a + (lanes){0.0, 0.0, along, 0.0}}};
}

/* Number of negative eigenvalues of a symmetric matrix: sign changes in the sequence of leading minors (Jacobi). */
static int negative_eigenvalues(const mat3 *a) {
    double second = a->m[0][0] * a->m[1][1] - a->m[0][1] * a->m[1][0];
    bool first_negative = a->m[0][0] < 0.0, second_negative = second < 0.0, third_negative = m3_determinant(a) < 0.0;
    return first_negative + (first_negative != second_negative) + (second_negative != third_negative);
}

/* Block L D L^T factorisation of the tangent stiffness from base to tip. D may be indefinite: needle and tissue together may be
   stable when the needle alone would buckle. */
static void factor_tangent(const needle_model *model, const needle_state *state, const vec3 *load, needle_tangent *tangent) {
    int n = model->given.segments;
    vec3 beyond[NEEDLE_MAX_SEGMENTS + 1];
    beyond[n] = v3(0, 0, 0);
    for (int k = n - 1; k >= 0; k--) beyond[k] = v3_axpy(model->segment_length, load[k + 1], beyond[k + 1]);

    row_matrix here, next = {{{0}}}, coupling = {{{0}}}, carried = {{{0}}};
    tangent->unstable = 0;
    tangent->rod.moments[0] = joint_stiffness(model, state, 0, &here);
    for (int k = 0; k < n; k++) {
        row_matrix sum = rm_subtract(rm_add(here, geometric_stiffness(beyond[k], q_axis(state->frames[k]))), carried);
        if (k + 1 < n) {
            vec3 m = v3_scale(0.5, tangent->rod.moments[k + 1] = joint_stiffness(model, state, k + 1, &next));
            sum = rm_add(sum, next);
            /* coupling of segment k with k + 1: -H + [m]x / 2, the second term because rotations do not commute */
            coupling = rm_subtract((row_matrix){{{0.0, -m.z, m.y, 0.0}, {m.z, 0.0, -m.x, 0.0}, {-m.y, m.x, 0.0, 0.0}}}, next);
        }
        mat3 pivot = matrix_of(sum);
        tangent->unstable += negative_eigenvalues(&pivot);
        tangent->rod.pivot_inverse[k] = m3_inverse(&pivot);
        if (k + 1 == n) break;
        row_matrix lower = rm_multiply_transposed(coupling, rows_of(&tangent->rod.pivot_inverse[k]));
        tangent->rod.lower[k + 1] = matrix_of(lower);
        carried = rm_multiply(lower, coupling);
        here = next;
    }
}

/* Solves the tangent system in place for the rotations of the segments. */
static void solve_tangent(int n, const needle_tangent *tangent, vec3 *rotation) {
    for (int k = 1; k < n; k++) rotation[k] = v3_sub(rotation[k], m3_apply(&tangent->rod.lower[k], rotation[k - 1]));
    for (int k = n - 1; k >= 0; k--) {
        rotation[k] = m3_apply(&tangent->rod.pivot_inverse[k], rotation[k]);
        if (k + 1 < n) rotation[k] = v3_sub(rotation[k], m3_apply_transposed(&tangent->rod.lower[k + 1], rotation[k + 1]));
    }
}

/* Three rows of a matrix with three columns for each joint. */
typedef double (*joint_rows)[NEEDLE_LD];
enum { BLOCK = 12 }; /* columns of four joints */

static void put_block(joint_rows rows, int joint, const mat3 *block) {
    for (int a = 0; a < 3; a++) memcpy(&rows[a][3 * joint], block->m[a], sizeof block->m[a]);
}

/* to = own - m^T from, where `own` is the same for every joint of columns [begin, end), in whole blocks. */
static void carry_back(const mat3 *own, const mat3 *m, joint_rows from, joint_rows to, int begin, int end) {
    double added[3][BLOCK];
    for (int a = 0; a < 3; a++)
        for (int c = 0; c < BLOCK; c++) added[a][c] = own->m[a][c % 3];
    for (int block = begin / BLOCK * BLOCK; block < end; block += BLOCK)
        for (int c = 0; c < BLOCK; c += LANES) {
            lanes x = lanes_load(&from[0][block + c]), y = lanes_load(&from[1][block + c]), z = lanes_load(&from[2][block + c]);
            for (int a = 0; a < 3; a++)
                lanes_store(&to[a][block + c], lanes_load(&added[a][c]) - m->m[0][a] * x - m->m[1][a] * y - m->m[2][a] * z);
        }
}

/* Each column x t. */
static row_matrix cross_columns(row_matrix m, vec3 t) {
    return (row_matrix){{t.z * m.row[1] - t.y * m.row[2], t.x * m.row[2] - t.z * m.row[0], t.y * m.row[0] - t.x * m.row[1]}};
}

/* Right-hand sides of the rotations under unit forces, after forward substitution, and length * axis of the segments. */
static void find_moments(const needle_model *model, const needle_state *state, const needle_tangent *tangent, vec3 *arm, row_matrix *moment) {
    for (int k = 0; k < model->given.segments; k++) {
        vec3 t = arm[k] = v3_scale(model->segment_length, q_axis(state->frames[k]));
        moment[k] = (row_matrix){{{0, -t.z, t.y, 0}, {t.z, 0, -t.x, 0}, {-t.y, t.x, 0, 0}}};
        if (k > 0) moment[k] = rm_subtract(moment[k], rm_multiply(rows_of(&tangent->rod.lower[k]), moment[k - 1]));
    }
}

/* Rotations under unit forces at the joints from `first` on, one column for each: a force at a joint exerts the moment length * axis x force on
   every segment before it, and none on those beyond. Forward substitution up to segment k is therefore the same for all joints beyond k, and
   backward substitution begins with the segment before the joint, whose block of the inverse stiffness (`own`) contains all that is beyond. Of
   segments from `last` on. */
static void find_rotations(int n, int first, int last, const row_matrix *moment, needle_tangent *tangent) {
    row_matrix own = {{{0}}};
    for (int k = n - 1; k >= last; k--) {
        joint_rows rows = &tangent->rod.rotation[3 * k];
        row_matrix pivot_inverse = rows_of(&tangent->rod.pivot_inverse[k]);
        if (k + 1 < n) {
            const mat3 *lower = &tangent->rod.lower[k + 1];
            mat3 free = matrix_of(rm_multiply(pivot_inverse, moment[k]));
            own = rm_multiply_transposed(rows_of(lower), rm_multiply(own, rows_of(lower)));
            carry_back(&free, lower, rows + 3, rows, 3 * (k + 2 > first ? k + 2 : first), 3 * (n + 1));
        }
        own = rm_add(own, pivot_inverse);
        mat3 here = matrix_of(rm_multiply(own, moment[k]));
        put_block(rows, k + 1, &here);
    }
}

/* Displacement of joint `last`, before which no force acts: segments before it turn by a sum of what is the same for all forces and a multiple of
   how segment `last` turns, and so does what they add up to. */
static void displace_base(int n, int first, int last, const vec3 *arm, const row_matrix *moment, needle_tangent *tangent, joint_rows sum) {
    row_matrix shift = {{{0}}}, by_turn = {{{0}}}, free = {{{0}}}, turn = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};
    for (int k = last - 1; k >= 0; k--) {
        row_matrix lower = rows_of(&tangent->rod.lower[k + 1]);
        free = rm_subtract(rm_multiply(rows_of(&tangent->rod.pivot_inverse[k]), moment[k]), rm_multiply_transposed(lower, free));
        turn = rm_subtract((row_matrix){{{0}}}, rm_multiply_transposed(lower, turn));
        shift = rm_add(shift, cross_columns(free, arm[k]));
        by_turn = rm_subtract(by_turn, cross_columns(turn, arm[k]));
    }
    mat3 same = matrix_of(shift), minus = matrix_of(by_turn), multiple = m3_transposed(&minus);
    carry_back(&same, &multiple, &tangent->rod.rotation[3 * last], sum, 3 * first, 3 * (n + 1));
}

/* Displacements of the joints from `last` + 1 on: sums of length * rotation x axis over the segments before them, from that of joint `last`. */
static void sum_displacements(int n, int first, int last, const vec3 *arm, joint_rows sum, needle_tangent *tangent) {
    int end = 3 * (n + 1);
    for (int k = last; k < n; k++) {
        vec3 t = arm[k];
        joint_rows rotation = &tangent->rod.rotation[3 * k], rows = &tangent->compliance[3 * (k + 1)];
        for (int c = lanes_below(3 * (k + 1 > first ? k + 1 : first)); c < end; c += LANES) {
            lanes x = lanes_load(&rotation[0][c]), y = lanes_load(&rotation[1][c]), z = lanes_load(&rotation[2][c]);
            lanes moved[3] = {y * t.z - z * t.y, z * t.x - x * t.z, x * t.y - y * t.x};
            for (int a = 0; a < 3; a++) {
                moved[a] += lanes_load(&sum[a][c]);
                lanes_store(&sum[a][c], moved[a]);
                lanes_store(&rows[a][c], moved[a]);
            }
        }
        int before = k + 2 - NEEDLE_POINT_JOINTS; /* joints of which a point next to this one may be interpolated, too */
        for (int c = 3 * (before > first ? before : first); c < 3 * (k + 1); c++) /* by symmetry */
            for (int a = 0; a < 3; a++) rows[a][c] = tangent->compliance[c][3 * (k + 1) + a];
    }
}

static void find_compliance(const needle_model *model, const needle_state *state, int first, needle_tangent *tangent) {
    int n = model->given.segments, last = first > 1 ? first - 1 : 0; /* no joint that counts is before this segment */
    vec3 arm[NEEDLE_MAX_SEGMENTS];
    row_matrix moment[NEEDLE_MAX_SEGMENTS];
    double sum[3][NEEDLE_LD] = {{0}};
    for (int a = 0; a < 3 && first == 0; a++)
        for (int c = 0; c < 3 * (n + 1); c++) tangent->compliance[a][c] = tangent->compliance[c][a] = 0.0; /* the base is fixed */
    find_moments(model, state, tangent, arm, moment);
    find_rotations(n, first, last, moment, tangent);
    if (last > 0) displace_base(n, first, last, arm, moment, tangent, sum);
    sum_displacements(n, first, last, arm, sum, tangent);
}

/* Rotations that relax the elastic moments at zero load. */
static void release_moments(int n, const needle_tangent *tangent, vec3 *rotation) {
    for (int k = 0; k < n; k++)
        rotation[k] = v3_sub(k + 1 < n ? tangent->rod.moments[k + 1] : v3(0, 0, 0), tangent->rod.moments[k]);
}

static void move_joints(const needle_model *model, const needle_state *state, const vec3 *rotation, vec3 *displacement) {
    displacement[0] = v3(0, 0, 0);
    for (int k = 0; k < model->given.segments; k++)
        displacement[k + 1] = v3_axpy(model->segment_length, v3_cross(rotation[k], q_axis(state->frames[k])), displacement[k]);
}

static void rod_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent) {
    int n = model->given.segments;
    vec3 rotation[NEEDLE_MAX_SEGMENTS];
    factor_tangent(model, state, load, tangent);
    release_moments(n, tangent, rotation);
    solve_tangent(n, tangent, rotation);
    move_joints(model, state, rotation, tangent->drift);
    find_compliance(model, state, first, tangent);
}

static double rod_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state) {
    int n = model->given.segments;
    vec3 rotation[NEEDLE_MAX_SEGMENTS], beyond = v3(0, 0, 0);
    release_moments(n, tangent, rotation);
    for (int k = n - 1; k >= 0; k--) {
        beyond = v3_axpy(model->segment_length, load[k + 1], beyond);
        rotation[k] = v3_add(rotation[k], v3_cross(q_axis(state->frames[k]), beyond));
    }
    solve_tangent(n, tangent, rotation);
    double largest = 0.0;
    for (int k = 0; k < n; k++) {
        largest = fmax(largest, v3_dot(rotation[k], rotation[k]));
        state->frames[k] = q_unit(q_multiply(q_exp(rotation[k]), state->frames[k]));
    }
    place_joints(model, state);
    return sqrt(largest);
}

/* ---- going on ------------------------------------------------------------------------------------------------------ */

static void rod_motion(const needle_model *model, const needle_state *before, const needle_state *after, needle_motion *motion) {
    for (int k = 0; k < model->given.segments; k++) motion->turn[k] = q_multiply(after->frames[k], q_conjugate(before->frames[k]));
}

/* A fraction of a small turn, to first order. */
static quat part_of(quat turn, double fraction) {
    double w = copysign(fraction, turn.w); /* the shorter way round */
    return q_unit((quat){1.0, w * turn.x, w * turn.y, w * turn.z});
}

static void rod_go_on(const needle_model *model, const needle_motion *motion, double fraction, needle_state *state) {
    for (int k = 0; k < model->given.segments; k++) state->frames[k] = q_multiply(part_of(motion->turn[k], fraction), state->frames[k]);
    place_joints(model, state);
}

static trocar_status rod_create(needle_model *model, report *why) {
    (void)model, (void)why;
    return TROCAR_OK;
}

const needle_kind needle_kind_rod = {rod_create, rod_rest, rod_hold, rod_linearise, rod_motion, rod_go_on, rod_advance,
                                     rod_root_moment, rod_energy};
