/* The needle as a geometrically exact Kirchhoff rod: a chain of rigid segments with elastic joints between them. */
#include "needle/needle_kind.h"

#include <stdbool.h>
#include <string.h>

#include "base/row_matrix.h"
#include "base/vec_lanes.h"

/* ---- shape, four segments at a time ---------------------------------------------------------------------------------- */

static inline void put_vectors(vector_series *to, int k, vec3_lanes v) {
    lanes_store(&to->at[0][k], v.x);
    lanes_store(&to->at[1][k], v.y);
    lanes_store(&to->at[2][k], v.z);
}

static inline vec3_lanes vectors_at(const vector_series *from, int k) {
    return (vec3_lanes){lanes_load(&from->at[0][k]), lanes_load(&from->at[1][k]), lanes_load(&from->at[2][k])};
}

static inline vec3 vector_at(const vector_series *from, int k) { return v3(from->at[0][k], from->at[1][k], from->at[2][k]); }

/* Orientations of the base and the segments; the last one is repeated to fill a vector. */
typedef struct {
    quat base_and_segments[1 + NEEDLE_PLACES];
} rod_frames;

static inline quat *frame_of(rod_frames *of, int segment) { return &of->base_and_segments[1 + segment]; }
static inline quat_lanes frames_at(const rod_frames *of, int segment) { return ql_load(&of->base_and_segments[1 + segment]); }

static void copy_frames(int n, const needle_state *state, rod_frames *to) {
    to->base_and_segments[0] = state->base.orientation;
    memcpy(frame_of(to, 0), state->frames, (size_t)n * sizeof *state->frames);
    for (int k = n; k < n + LANES; k++) *frame_of(to, k) = state->frames[n - 1];
}

/* Length times axis of segments k to k + 3. */
static inline vec3_lanes arms_of(const needle_model *model, const rod_frames *of, int k) {
    return v3l_scale(lanes_all(model->segment_length), ql_axis(frames_at(of, k)));
}

/* Turns the segments, and the joints follow. */
static void set_frames(const needle_model *model, const rod_frames *of, needle_state *state) {
    int n = model->given.segments;
    vector_series arm;
    memcpy(state->frames, &of->base_and_segments[1], (size_t)n * sizeof *state->frames);
    for (int k = 0; k < n; k += LANES) put_vectors(&arm, k, arms_of(model, of, k));
    state->joints[0] = state->base.position;
    for (int k = 0; k < n; k++) state->joints[k + 1] = v3_add(state->joints[k], vector_at(&arm, k));
}

static void rod_rest(const needle_model *model, pose base, needle_state *state) {
    rod_frames of;
    state->base = base;
    for (int k = 0; k < model->given.segments + LANES; k++) *frame_of(&of, k) = base.orientation;
    set_frames(model, &of, state);
}

/* No load twists the rod, so that every segment turns about its own axis by as much as the base does. */
static void rod_hold(const needle_model *model, pose base, needle_state *state) {
    double roll = q_roll_between(state->base.orientation, base.orientation);
    quat turn = q_exp(v3(0, 0, roll));
    rod_frames of;
    state->base = base;
    copy_frames(model->given.segments, state, &of);
    for (int k = 0; k < model->given.segments && roll != 0.0; k++) *frame_of(&of, k) = q_unit(q_multiply(*frame_of(&of, k), turn));
    set_frames(model, &of, state);
}

/* ---- elasticity of the joints ------------------------------------------------------------------------------------------ */

static const int SYMMETRIC[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}}; /* where a symmetric matrix keeps its components */

/* Joint k precedes segment k. The joint at the base represents half a segment of bending length, the others one segment. */
static double joint_length(const needle_model *model, int k) { return (k == 0 ? 0.5 : 1.0) * model->segment_length; }

/* Stiffness of joints k to k + 3, N m; rigidity: EI or GJ. */
static lanes joint_stiffness(const needle_model *model, double rigidity, int k) {
    lanes stiffness = lanes_all(rigidity / model->segment_length);
    stiffness[0] = rigidity / joint_length(model, k);
    return stiffness;
}

/* Rotation vectors of segments k to k + 3 relative to those before them. */
static vec3_lanes joint_curvature(const rod_frames *of, int k) {
    return ql_log(ql_multiply(ql_conjugate(frames_at(of, k - 1)), frames_at(of, k)));
}

/* Inverse of the right Jacobian of SO(3): rate of the rotation vector w per body rotation (Sola et al. 2018, eq. 144). */
static mat3_lanes inverse_right_jacobian(vec3_lanes w) {
    lanes angle2 = v3l_dot(w, w), c = 1.0 / 12 + angle2 * (1.0 / 720 + angle2 * (1.0 / 30240 + angle2 / 1209600)); /* to 1e-15 */
    for (int i = 0; i < LANES; i++) {
        if (angle2[i] < 1e-2) continue;
        double angle = sqrt(angle2[i]);
        c[i] = 1.0 / angle2[i] - (1.0 + cos(angle)) / (2.0 * angle * sin(angle));
    }
    lanes own = 1.0 - c * angle2;
    vec3_lanes v = v3l_scale(c, w), half = v3l_scale(lanes_all(0.5), w);
    return (mat3_lanes){{{v.x * w.x + own, v.x * w.y - half.z, v.x * w.z + half.y},
                         {v.y * w.x + half.z, v.y * w.y + own, v.y * w.z - half.x},
                         {v.z * w.x - half.y, v.z * w.y + half.x, v.z * w.z + own}}};
}

/* Spatial moments of joints k to k + 3, and their stiffness (symmetric) against the relative spatial rotation of their two segments. */
static vec3_lanes joint_moments(const needle_model *model, const rod_frames *of, int k, lanes stiffness[6]) {
    lanes bending = joint_stiffness(model, model->bending, k), torsion = joint_stiffness(model, model->torsion, k);
    vec3_lanes w = joint_curvature(of, k);
    quat_lanes frame = frames_at(of, k);
    vec3_lanes x = ql_axis_x(frame), y = ql_axis_y(frame), z = ql_axis(frame);
    mat3_lanes jacobian = inverse_right_jacobian(w), axes = {{{x.x, x.y, x.z}, {y.x, y.y, y.z}, {z.x, z.y, z.z}}};
    mat3_lanes turned = m3l_multiply(&jacobian, &axes), resisted;
    for (int j = 0; j < 3; j++) {
        resisted.m[0][j] = bending * turned.m[0][j];
        resisted.m[1][j] = bending * turned.m[1][j];
        resisted.m[2][j] = torsion * turned.m[2][j];
    }
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++)
            stiffness[SYMMETRIC[i][j]] = turned.m[0][i] * resisted.m[0][j] + turned.m[1][i] * resisted.m[1][j] + turned.m[2][i] * resisted.m[2][j];
    lanes moment[3];
    for (int j = 0; j < 3; j++) moment[j] = w.x * resisted.m[0][j] + w.y * resisted.m[1][j] + w.z * resisted.m[2][j];
    return (vec3_lanes){moment[0], moment[1], moment[2]};
}

static vec3 rod_root_moment(const needle_model *model, const needle_state *state) {
    lanes unused[6];
    rod_frames of;
    copy_frames(model->given.segments, state, &of);
    vec3_lanes moment = joint_moments(model, &of, 0, unused);
    return v3(moment.x[0], moment.y[0], moment.z[0]);
}

static double rod_energy(const needle_model *model, const needle_state *state) {
    double energy = 0.0;
    quat before = state->base.orientation;
    for (int k = 0; k < model->given.segments; k++) {
        vec3 w = q_log(q_multiply(q_conjugate(before), state->frames[k]));
        energy += 0.5 / joint_length(model, k) * (model->bending * (w.x * w.x + w.y * w.y) + model->torsion * w.z * w.z);
        before = state->frames[k];
    }
    return energy;
}

/* ---- tangent ------------------------------------------------------------------------------------------------------- */

/* The tangent stiffness, block tridiagonal, and what the forward substitution makes of right-hand sides. */
typedef struct {
    symmetric_series joint, segment;         /* N m, stiffness of each joint, and block of each segment on the diagonal */
    matrix_series coupling;                  /* N m, of segment k with k + 1 */
    vector_series arm;                       /* m, length times axis of each segment */
    vector_series beyond;                    /* N, sum of the loads beyond the joint before each segment */
    row_matrix sides[NEEDLE_MAX_SEGMENTS];   /* moments under unit forces beyond each segment; fourth column: those that relax the joints' */
} rod_chain;

static void sum_loads(int n, const vec3 *load, vector_series *beyond) {
    vec3 sum = v3(0, 0, 0);
    for (int i = 0; i < 3; i++)
        for (int k = n; k < n + LANES; k++) beyond->at[i][k] = 0.0;
    for (int k = n - 1; k >= 0; k--) {
        sum = v3_add(sum, load[k + 1]);
        beyond->at[0][k] = sum.x;
        beyond->at[1][k] = sum.y;
        beyond->at[2][k] = sum.z;
    }
}

/* Second variation of -n.t under spatial rotations of a segment (n: sum of the forces beyond it, t: length times axis). */
static inline void add_geometric_stiffness(vec3_lanes n, vec3_lanes t, lanes sum[6]) {
    lanes along = v3l_dot(n, t), a[3] = {-0.5 * n.x, -0.5 * n.y, -0.5 * n.z}, b[3] = {t.x, t.y, t.z};
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++) sum[SYMMETRIC[i][j]] += a[i] * b[j] + b[i] * a[j];
    for (int i = 0; i < 3; i++) sum[SYMMETRIC[i][i]] += along;
}

static void assemble_chain(const needle_model *model, const needle_state *state, const vec3 *load, rod_chain *chain, needle_tangent *tangent) {
    int n = model->given.segments;
    rod_frames of;
    copy_frames(n, state, &of);
    sum_loads(n, load, &chain->beyond);
    for (int k = 0; k < n; k += LANES) {
        lanes stiffness[6];
        put_vectors(&tangent->rod.moments, k, joint_moments(model, &of, k, stiffness));
        for (int i = 0; i < 6; i++) lanes_store(&chain->joint.at[i][k], stiffness[i]);
    }
    for (int i = 0; i < 6; i++) chain->joint.at[i][n] = 0.0; /* the tip is free */
    for (int i = 0; i < 3; i++) tangent->rod.moments.at[i][n] = 0.0;
    for (int k = 0; k < n; k += LANES) {
        lanes own[6], next[6];
        for (int i = 0; i < 6; i++) own[i] = lanes_load(&chain->joint.at[i][k]) + (next[i] = lanes_load(&chain->joint.at[i][k + 1]));
        vec3_lanes arm = arms_of(model, &of, k);
        add_geometric_stiffness(vectors_at(&chain->beyond, k), arm, own);
        put_vectors(&chain->arm, k, arm);
        for (int i = 0; i < 6; i++) lanes_store(&chain->segment.at[i][k], own[i]);
        /* -H + [m]x / 2, the second term because rotations do not commute */
        vec3_lanes m = v3l_scale(lanes_all(0.5), vectors_at(&tangent->rod.moments, k + 1));
        const lanes coupling[9] = {-next[0], -m.z - next[1], m.y - next[2], m.z - next[1], -next[3], -m.x - next[4], -m.y - next[2], m.x - next[4], -next[5]};
        for (int i = 0; i < 9; i++) lanes_store(&chain->coupling.at[i][k], coupling[i]);
    }
}

/* Number of negative eigenvalues of a symmetric matrix: sign changes in the sequence of leading minors (Jacobi). */
static int negative_eigenvalues(double first, double second, double third) {
    return (first < 0.0) + ((first < 0.0) != (second < 0.0)) + ((second < 0.0) != (third < 0.0));
}

/* Block L D L^T factorisation of the tangent stiffness from base to tip. D may be indefinite: needle and tissue together may be
   stable when the needle alone would buckle. Each block waits for the one before: while a determinant is being divided by, the adjugate is
   multiplied. */
static void factor_tangent(int n, const rod_chain *chain, needle_tangent *tangent) {
    symmetric_series *adjugate = &tangent->rod.pivot_inverse;
    double inverse_determinant[NEEDLE_PLACES], carried[6] = {0.0};
    tangent->unstable = 0;
    for (int k = 0; k < n; k++) {
        double p[6], c[9];
        for (int i = 0; i < 6; i++) p[i] = chain->segment.at[i][k] - carried[i];
        const double adj[6] = {p[3] * p[5] - p[4] * p[4], p[2] * p[4] - p[1] * p[5], p[1] * p[4] - p[2] * p[3],
                               p[0] * p[5] - p[2] * p[2], p[1] * p[2] - p[0] * p[4], p[0] * p[3] - p[1] * p[1]};
        double determinant = p[0] * adj[0] + p[1] * adj[1] + p[2] * adj[2], inverse = 1.0 / determinant, product[3][3];
        tangent->unstable += negative_eigenvalues(p[0], adj[5], determinant);
        for (int i = 0; i < 6; i++) adjugate->at[i][k] = adj[i];
        inverse_determinant[k] = inverse;
        for (int i = 0; i < 9; i++) c[i] = chain->coupling.at[i][k];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) product[i][j] = adj[SYMMETRIC[i][0]] * c[j] + adj[SYMMETRIC[i][1]] * c[3 + j] + adj[SYMMETRIC[i][2]] * c[6 + j];
        for (int i = 0; i < 3; i++)
            for (int j = i; j < 3; j++)
                carried[SYMMETRIC[i][j]] = inverse * (c[i] * product[0][j] + c[3 + i] * product[1][j] + c[6 + i] * product[2][j]);
    }
    for (int k = n; k < n + LANES; k++) { /* the rest of the last vector: computed with, but never used */
        inverse_determinant[k] = 0.0;
        for (int i = 0; i < 6; i++) adjugate->at[i][k] = 0.0;
    }
    for (int k = 0; k < n; k += LANES) {
        lanes scale = lanes_load(&inverse_determinant[k]), pivot_inverse[6], c[9];
        for (int i = 0; i < 6; i++) lanes_store(&adjugate->at[i][k], pivot_inverse[i] = scale * lanes_load(&adjugate->at[i][k]));
        for (int i = 0; i < 9; i++) c[i] = lanes_load(&chain->coupling.at[i][k]);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                const lanes column[3] = {pivot_inverse[SYMMETRIC[0][j]], pivot_inverse[SYMMETRIC[1][j]], pivot_inverse[SYMMETRIC[2][j]]};
                lanes_store(&tangent->rod.lower.at[3 * i + j][k + 1], c[i] * column[0] + c[3 + i] * column[1] + c[6 + i] * column[2]);
            }
    }
}

static inline row_matrix lower_at(const needle_tangent *tangent, int k) {
    row_matrix m;
    for (int i = 0; i < 3; i++) m.row[i] = (lanes){tangent->rod.lower.at[3 * i][k], tangent->rod.lower.at[3 * i + 1][k], tangent->rod.lower.at[3 * i + 2][k], 0.0};
    return m;
}

static inline row_matrix pivot_inverse_at(const needle_tangent *tangent, int k) {
    row_matrix m;
    double x[6];
    for (int i = 0; i < 6; i++) x[i] = tangent->rod.pivot_inverse.at[i][k];
    for (int i = 0; i < 3; i++) m.row[i] = (lanes){x[SYMMETRIC[i][0]], x[SYMMETRIC[i][1]], x[SYMMETRIC[i][2]], 0.0};
    return m;
}

/* Moments that relax those of the joints at zero load, of segments k to k + 3. */
static inline vec3_lanes released_moments(const vector_series *moments, int k) {
    return v3l_sub(vectors_at(moments, k + 1), vectors_at(moments, k));
}

/* Solves the tangent system in place for the rotations of the segments. */
static void solve_tangent(int n, const needle_tangent *tangent, vector_series *rotation) {
    const double (*lower)[NEEDLE_PLACES] = tangent->rod.lower.at;
    double x = rotation->at[0][0], y = rotation->at[1][0], z = rotation->at[2][0];
    for (int k = 1; k < n; k++) {
        double next[3];
        for (int i = 0; i < 3; i++) rotation->at[i][k] = next[i] = rotation->at[i][k] - lower[3 * i][k] * x - lower[3 * i + 1][k] * y - lower[3 * i + 2][k] * z;
        x = next[0], y = next[1], z = next[2];
    }
    for (int k = 0; k < n; k += LANES) {
        vec3_lanes r = vectors_at(rotation, k);
        lanes s[6];
        for (int i = 0; i < 6; i++) s[i] = lanes_load(&tangent->rod.pivot_inverse.at[i][k]);
        put_vectors(rotation, k, (vec3_lanes){s[0] * r.x + s[1] * r.y + s[2] * r.z, s[1] * r.x + s[3] * r.y + s[4] * r.z, s[2] * r.x + s[4] * r.y + s[5] * r.z});
    }
    x = rotation->at[0][n - 1], y = rotation->at[1][n - 1], z = rotation->at[2][n - 1];
    for (int k = n - 2; k >= 0; k--) {
        double next[3];
        for (int i = 0; i < 3; i++) rotation->at[i][k] = next[i] = rotation->at[i][k] - lower[i][k + 1] * x - lower[3 + i][k + 1] * y - lower[6 + i][k + 1] * z;
        x = next[0], y = next[1], z = next[2];
    }
}

/* Three rows of a matrix with three columns for each joint. */
typedef double (*joint_rows)[NEEDLE_LD];
enum { BLOCK = 12 }; /* columns of four joints */

static void put_block(joint_rows rows, int joint, const mat3 *block) {
    for (int a = 0; a < 3; a++) memcpy(&rows[a][3 * joint], block->m[a], sizeof block->m[a]);
}

/* to = own - m^T from, where `own` is the same for every joint of columns [begin, end), in whole blocks. */
static void carry_back(const row_matrix *own, const mat3 *m, joint_rows from, joint_rows to, int begin, int end) {
    lanes added[3][BLOCK / LANES];
    for (int a = 0; a < 3; a++) {
        lanes r = own->row[a];
        added[a][0] = __builtin_shufflevector(r, r, 0, 1, 2, 0);
        added[a][1] = __builtin_shufflevector(r, r, 1, 2, 0, 1);
        added[a][2] = __builtin_shufflevector(r, r, 2, 0, 1, 2);
    }
    for (int block = begin / BLOCK * BLOCK; block < end; block += BLOCK)
        for (int i = 0; i < BLOCK / LANES; i++) {
            int c = block + i * LANES;
            lanes x = lanes_load(&from[0][c]), y = lanes_load(&from[1][c]), z = lanes_load(&from[2][c]);
            for (int a = 0; a < 3; a++) lanes_store(&to[a][c], added[a][i] - m->m[0][a] * x - m->m[1][a] * y - m->m[2][a] * z);
        }
}

/* Forward substitution of the right-hand sides. A force at a joint exerts the moment length * axis x force on every segment before it. */
static void substitute_forward(int n, const needle_tangent *tangent, rod_chain *chain) {
    vector_series released;
    for (int k = 0; k < n; k += LANES) put_vectors(&released, k, released_moments(&tangent->rod.moments, k));
    for (int k = 0; k < n; k++) {
        vec3 t = vector_at(&chain->arm, k), r = vector_at(&released, k);
        row_matrix side = {{{0, -t.z, t.y, r.x}, {t.z, 0, -t.x, r.y}, {-t.y, t.x, 0, r.z}}};
        if (k > 0) side = rm_subtract(side, rm_multiply(lower_at(tangent, k), chain->sides[k - 1]));
        chain->sides[k] = side;
    }
}

/* Displacement of joint `last`, before which no force acts. With S what forward substitution makes of the moments under a force there, and P the pivots,
   it is the sum of S^T P^-1 S over the segments before, less a multiple of how segment `last` turns. Fourth column: at zero load. */
static row_matrix displace_base(int last, const needle_tangent *tangent, const rod_chain *chain) {
    row_matrix sum = {{{0}}};
    for (int k = 0; k < last; k++) sum = rm_add(sum, rm_multiply_transposed(chain->sides[k], rm_multiply(pivot_inverse_at(tangent, k), chain->sides[k])));
    return sum;
}

/* Rotations of the segments from `last` on under unit forces at the joints from `first` on, one column for each, and at zero load (`turn`). A force at a
   joint exerts no moment on segments beyond it. Forward substitution up to segment k is therefore the same for all joints beyond k, and backward
   substitution begins with the segment before the joint, whose block of the inverse stiffness (`own`) contains all that is beyond. */
static void find_rotations(int n, int first, int last, const row_matrix *sides, needle_tangent *tangent, vec3 *turn) {
    row_matrix own = {{{0}}};
    for (int k = n - 1; k >= last; k--) {
        joint_rows rows = &tangent->rod.rotation[3 * k];
        row_matrix pivot_inverse = pivot_inverse_at(tangent, k), solved = rm_multiply(pivot_inverse, sides[k]);
        turn[k] = v3(solved.row[0][3], solved.row[1][3], solved.row[2][3]);
        if (k + 1 < n) {
            row_matrix lower = lower_at(tangent, k + 1);
            mat3 carried = matrix_of(lower);
            own = rm_multiply_transposed(lower, rm_multiply(own, lower));
            carry_back(&solved, &carried, rows + 3, rows, 3 * (k + 2 > first ? k + 2 : first), 3 * (n + 1));
            turn[k] = v3_sub(turn[k], m3_apply_transposed(&carried, turn[k + 1]));
        }
        own = rm_add(own, pivot_inverse);
        mat3 here = matrix_of(rm_multiply(own, sides[k]));
        put_block(rows, k + 1, &here);
    }
}

/* Displacements of the joints from `last` + 1 on: sums of length * rotation x axis over the segments before them, from that of joint `last`. */
static void sum_displacements(int n, int first, int last, const vector_series *arm, joint_rows sum, needle_tangent *tangent) {
    int end = 3 * (n + 1);
    for (int k = last; k < n; k++) {
        vec3 t = vector_at(arm, k);
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

/* Compliance between the joints from `first` on, and their displacement at zero load. */
static void find_compliance(int n, int first, const rod_chain *chain, needle_tangent *tangent) {
    int last = first > 1 ? first - 1 : 0; /* no joint that counts is before this segment */
    vec3 turn[NEEDLE_MAX_SEGMENTS], *drift = tangent->drift;
    double sum[3][NEEDLE_LD] = {{0}};
    for (int a = 0; a < 3 && first == 0; a++)
        for (int c = 0; c < 3 * (n + 1); c++) tangent->compliance[a][c] = tangent->compliance[c][a] = 0.0; /* the base is fixed */
    find_rotations(n, first, last, chain->sides, tangent, turn);
    drift[last] = v3(0, 0, 0);
    if (last > 0) {
        row_matrix base = displace_base(last, tangent, chain);
        mat3 by_turn = matrix_of(rm_multiply(lower_at(tangent, last), chain->sides[last - 1]));
        carry_back(&base, &by_turn, &tangent->rod.rotation[3 * last], sum, 3 * first, 3 * (n + 1));
        drift[last] = v3_sub(v3(base.row[0][3], base.row[1][3], base.row[2][3]), m3_apply_transposed(&by_turn, turn[last]));
    }
    for (int k = last; k < n; k++) drift[k + 1] = v3_add(drift[k], v3_cross(turn[k], vector_at(&chain->arm, k)));
    sum_displacements(n, first, last, &chain->arm, sum, tangent);
}

static void rod_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent) {
    int n = model->given.segments;
    rod_chain chain;
    assemble_chain(model, state, load, &chain, tangent);
    factor_tangent(n, &chain, tangent);
    substitute_forward(n, tangent, &chain);
    find_compliance(n, first, &chain, tangent);
}

static double rod_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state) {
    int n = model->given.segments;
    vector_series beyond, rotation;
    rod_frames of;
    copy_frames(n, state, &of);
    sum_loads(n, load, &beyond);
    for (int k = 0; k < n; k += LANES) {
        vec3_lanes released = released_moments(&tangent->rod.moments, k), arm = arms_of(model, &of, k);
        put_vectors(&rotation, k, v3l_add(released, v3l_cross(arm, vectors_at(&beyond, k))));
    }
    solve_tangent(n, tangent, &rotation);
    double largest = 0.0;
    for (int k = 0; k < n; k += LANES) {
        vec3_lanes r = vectors_at(&rotation, k);
        lanes angle2 = v3l_dot(r, r);
        for (int i = 0; i < LANES && k + i < n; i++) largest = fmax(largest, angle2[i]);
        ql_store(frame_of(&of, k), ql_unit(ql_multiply(ql_exp(r), frames_at(&of, k))));
    }
    set_frames(model, &of, state);
    return sqrt(largest);
}

/* ---- going on ------------------------------------------------------------------------------------------------------ */

static void rod_motion(const needle_model *model, const needle_state *before, const needle_state *after, needle_motion *motion) {
    for (int k = 0; k < model->given.segments; k++) motion->turn[k] = q_multiply(after->frames[k], q_conjugate(before->frames[k]));
}

/* A fraction of small turns, to first order. */
static quat_lanes part_of(quat_lanes turn, lanes fraction) {
    lanes w = fraction * lanes_signs(turn.w); /* the shorter way round */
    return ql_unit((quat_lanes){lanes_all(1.0), w * turn.x, w * turn.y, w * turn.z});
}

static void rod_go_on(const needle_model *model, const needle_motion *motion, double fraction, needle_state *state) {
    rod_frames of;
    copy_frames(model->given.segments, state, &of);
    for (int k = 0; k < model->given.segments; k += LANES)
        ql_store(frame_of(&of, k), ql_multiply(part_of(ql_load(&motion->turn[k]), lanes_all(fraction)), frames_at(&of, k)));
    set_frames(model, &of, state);
}

static trocar_status rod_create(needle_model *model, report *why) {
    (void)model, (void)why;
    return TROCAR_OK;
}

const needle_kind needle_kind_rod = {rod_create, rod_rest, rod_hold, rod_linearise, rod_motion, rod_go_on, rod_advance,
                                     rod_root_moment, rod_energy};
