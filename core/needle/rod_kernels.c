#include "needle/rod_kernels.h"

#include <string.h>

#include "linalg/row_matrix.h"
#include "linalg/vec_simd4.h"

_Static_assert((int)ROD_STEP == SIMD4_WIDTH, "a step is one vector");

/* ---- shape, four segments at a time ---------------------------------------------------------------------------------- */

static inline void put_vectors(vector_series *to, int k, vec3_simd4 v) {
    simd4_store(&to->at[0][k], v.x);
    simd4_store(&to->at[1][k], v.y);
    simd4_store(&to->at[2][k], v.z);
}

static inline vec3_simd4 vectors_at(const vector_series *from, int k) {
    return (vec3_simd4){simd4_load(&from->at[0][k]), simd4_load(&from->at[1][k]), simd4_load(&from->at[2][k])};
}

static inline vec3 vector_at(const vector_series *from, int k) { return v3(from->at[0][k], from->at[1][k], from->at[2][k]); }

static inline quat_simd4 frames_at(const rod_frames *of, int segment) { return ql_load(&of->base_and_segments[1 + segment]); }

/* Returns the vectors along segments k to k + 3, from one end to the other. */
static inline vec3_simd4 arms_of(const needle_model *model, const rod_frames *of, int k) {
    return v3l_scale(simd4_all(model->segment_length), ql_axis(frames_at(of, k)));
}

void rod_set_frames(const needle_model *model, const rod_frames *of, needle_state *state) {
    int n = model->given.segments;
    vector_series arm;
    memcpy(state->frames, &of->base_and_segments[1], (size_t)n * sizeof *state->frames);
    for (int k = 0; k < n; k += SIMD4_WIDTH) put_vectors(&arm, k, arms_of(model, of, k));
    state->joints[0] = state->base.position;
    for (int k = 0; k < n; k++) state->joints[k + 1] = v3_add(state->joints[k], vector_at(&arm, k));
}

/* ---- elasticity of the joints ------------------------------------------------------------------------------------------ */

static const int SYMMETRIC[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}}; /* where each entry of a symmetric 3 x 3 matrix is stored */

/* Returns the stiffness (N m) of joints k to k + 3 in bending or torsion. `rigidity`: EI or GJ. */
static simd4 joint_stiffness(const needle_model *model, double rigidity, int k) {
    simd4 stiffness = simd4_all(rigidity / model->segment_length);
    stiffness[0] = rigidity / rod_joint_length(model, k);
    return stiffness;
}

/* Returns the rotation vectors of segments k to k + 3, each relative to the segment before it. */
static vec3_simd4 joint_curvature(const rod_frames *of, int k) {
    return ql_log(ql_multiply(ql_conjugate(frames_at(of, k - 1)), frames_at(of, k)));
}

/* Returns the factor c of [w]x^2 in the inverse Jacobians of SO(3). It depends only on |w|^2 (`angle2`). */
static simd4 square_factor(simd4 angle2) {
    simd4 c = 1.0 / 12 + angle2 * (1.0 / 720 + angle2 * (1.0 / 30240 + angle2 / 1209600)); /* accurate to 1e-15 */
    for (int i = 0; i < SIMD4_WIDTH; i++) {
        if (angle2[i] < 1e-2) continue;
        double angle = sqrt(angle2[i]);
        c[i] = 1.0 / angle2[i] - (1.0 + cos(angle)) / (2.0 * angle * sin(angle));
    }
    return c;
}

/* Returns the inverse of the right Jacobian of SO(3), I + [w]x / 2 + c [w]x^2, which maps a body rotation to the change in the rotation vector w (Sola et al.
   2018, eq. 144). */
static mat3_simd4 inverse_right_jacobian(vec3_simd4 w, simd4 c) {
    simd4 own = 1.0 - c * v3l_dot(w, w);
    vec3_simd4 v = v3l_scale(c, w), half = v3l_scale(simd4_all(0.5), w);
    return (mat3_simd4){{{v.x * w.x + own, v.x * w.y - half.z, v.x * w.z + half.y},
                         {v.y * w.x + half.z, v.y * w.y + own, v.y * w.z - half.x},
                         {v.z * w.x - half.y, v.z * w.y + half.x, v.z * w.z + own}}};
}

/* Computes the spatial moments at joints k to k + 3, and the joints' (symmetric) stiffness against relative spatial rotation of the adjacent segments. If the
   stiffness b were the same in all directions, the energy b |w|^2 / 2 would give the moment b w and, to second order in a rotation, the stiffness b (I + c
   [w]x^2). This is the sum of J^T J and the curvature of the logarithm, (1/4 - c) [w]x^2 - c^2 [w]x^4. A torsional stiffness t adds the energy (t - b) w_z^2 /
   2, and the corresponding stiffness follows from the rate of w_z. The derivative of that rate would add a term proportional to w_z, which is omitted because
   no load twists the rod. The second-order terms are needed: without them, the iteration fails to converge when a bowed needle is nearly free to rotate about
   its axis. */
static vec3_simd4 joint_moments(const needle_model *model, const rod_frames *of, int k, simd4 stiffness[6]) {
    simd4 bending = joint_stiffness(model, model->bending, k), more = joint_stiffness(model, model->torsion, k) - bending;
    vec3_simd4 w = joint_curvature(of, k);
    quat_simd4 frame = frames_at(of, k);
    vec3_simd4 x = ql_axis_x(frame), y = ql_axis_y(frame), z = ql_axis(frame);
    simd4 angle2 = v3l_dot(w, w), c = square_factor(angle2);
    mat3_simd4 jacobian = inverse_right_jacobian(w, c);
    vec3_simd4 turned = v3l_axpy(w.x, x, v3l_axpy(w.y, y, v3l_scale(w.z, z))); /* w, world frame */
    vec3_simd4 rate = v3l_axpy(jacobian.m[2][0], x, v3l_axpy(jacobian.m[2][1], y, v3l_scale(jacobian.m[2][2], z))); /* rate of w_z */
    vec3_simd4 aside = v3l_axpy(jacobian.m[0][0], x, v3l_axpy(jacobian.m[0][1], y, v3l_scale(jacobian.m[0][2], z))); /* rate of w_x */
    simd4 natural = simd4_load(&model->natural[k]);
    const simd4 v[3] = {turned.x, turned.y, turned.z}, r[3] = {rate.x, rate.y, rate.z};
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++) stiffness[SYMMETRIC[i][j]] = bending * c * v[i] * v[j] + more * r[i] * r[j];
    for (int i = 0; i < 3; i++) stiffness[SYMMETRIC[i][i]] += bending * (1.0 - c * angle2);
    return v3l_axpy(-bending * natural, aside, v3l_axpy(more * w.z, rate, v3l_scale(bending, turned)));
}

vec3 rod_root_moment(const needle_model *model, const needle_state *state) {
    simd4 unused[6];
    rod_frames of;
    rod_copy_frames(model->given.segments, state, &of);
    vec3_simd4 moment = joint_moments(model, &of, 0, unused);
    return v3(moment.x[0], moment.y[0], moment.z[0]);
}

/* ---- tangent ------------------------------------------------------------------------------------------------------- */

/* The block tridiagonal tangent stiffness, and the right-hand sides after forward substitution. */
typedef struct {
    symmetric_series joint, segment;         /* N m; joint: stiffness of each joint; segment: diagonal block of each segment */
    matrix_series coupling;                  /* N m, coupling between segments k and k + 1 */
    vector_series arm;                       /* m, vector along each segment: length times axis */
    vector_series beyond;                    /* N, sum of the loads on all joints beyond each segment, including the one at its far end */
    row_matrix sides[NEEDLE_MAX_SEGMENTS];   /* moments on each segment: three columns for unit forces at any joint beyond it, and a fourth for zero load, where
                                                the joints relax */
} rod_chain;

static void sum_loads(int n, const vec3 *load, vector_series *beyond) {
    vec3 sum = v3(0, 0, 0);
    for (int i = 0; i < 3; i++)
        for (int k = n; k < n + SIMD4_WIDTH; k++) beyond->at[i][k] = 0.0;
    for (int k = n - 1; k >= 0; k--) {
        sum = v3_add(sum, load[k + 1]);
        beyond->at[0][k] = sum.x;
        beyond->at[1][k] = sum.y;
        beyond->at[2][k] = sum.z;
    }
}

/* Adds the second variation of -n.t when a segment is rotated (in the world frame). n: the total force beyond the segment. t: the vector along it. */
static inline void add_geometric_stiffness(vec3_simd4 n, vec3_simd4 t, simd4 sum[6]) {
    simd4 along = v3l_dot(n, t), a[3] = {-0.5 * n.x, -0.5 * n.y, -0.5 * n.z}, b[3] = {t.x, t.y, t.z};
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++) sum[SYMMETRIC[i][j]] += a[i] * b[j] + b[i] * a[j];
    for (int i = 0; i < 3; i++) sum[SYMMETRIC[i][i]] += along;
}

static void assemble_chain(const needle_model *model, const needle_state *state, const vec3 *load, rod_chain *chain, needle_tangent *tangent) {
    int n = model->given.segments;
    rod_frames of;
    rod_copy_frames(n, state, &of);
    sum_loads(n, load, &chain->beyond);
    for (int k = 0; k < n; k += SIMD4_WIDTH) {
        simd4 stiffness[6];
        put_vectors(&tangent->moments, k, joint_moments(model, &of, k, stiffness));
        for (int i = 0; i < 6; i++) simd4_store(&chain->joint.at[i][k], stiffness[i]);
    }
    for (int i = 0; i < 6; i++) chain->joint.at[i][n] = 0.0; /* the tip is free */
    for (int i = 0; i < 3; i++) tangent->moments.at[i][n] = 0.0;
    for (int k = 0; k < n; k += SIMD4_WIDTH) {
        simd4 own[6], next[6];
        for (int i = 0; i < 6; i++) own[i] = simd4_load(&chain->joint.at[i][k]) + (next[i] = simd4_load(&chain->joint.at[i][k + 1]));
        vec3_simd4 arm = arms_of(model, &of, k);
        add_geometric_stiffness(vectors_at(&chain->beyond, k), arm, own);
        put_vectors(&chain->arm, k, arm);
        for (int i = 0; i < 6; i++) simd4_store(&chain->segment.at[i][k], own[i]);
        /* -H + [m]x / 2. The second term arises because rotations do not commute. */
        vec3_simd4 m = v3l_scale(simd4_all(0.5), vectors_at(&tangent->moments, k + 1));
        const simd4 coupling[9] = {-next[0], -m.z - next[1], m.y - next[2], m.z - next[1], -next[3], -m.x - next[4], -m.y - next[2], m.x - next[4], -next[5]};
        for (int i = 0; i < 9; i++) simd4_store(&chain->coupling.at[i][k], coupling[i]);
    }
}

/* Returns how many eigenvalues of a symmetric 3 x 3 matrix are negative, given its leading principal minors: as many as there are sign changes in the sequence
   1, first, second, third (Jacobi). */
static int negative_eigenvalues(double first, double second, double third) {
    return (first < 0.0) + ((first < 0.0) != (second < 0.0)) + ((second < 0.0) != (third < 0.0));
}

/* Factorises the tangent stiffness as block L D L^T, from base to tip. D may be indefinite, because needle and tissue together may be stable even if the needle
   alone would buckle. Each block depends on the previous one. To shorten this dependency chain, the products use the adjugate, so they need not wait for the
   division by the determinant. */
static void factor_tangent(int n, const rod_chain *chain, needle_tangent *tangent) {
    symmetric_series *adjugate = &tangent->pivot_inverse;
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
    for (int k = n; k < n + SIMD4_WIDTH; k++) { /* padding: these lanes of the last vector are computed but never used */
        inverse_determinant[k] = 0.0;
        for (int i = 0; i < 6; i++) adjugate->at[i][k] = 0.0;
    }
    for (int k = 0; k < n; k += SIMD4_WIDTH) {
        simd4 scale = simd4_load(&inverse_determinant[k]), pivot_inverse[6], c[9];
        for (int i = 0; i < 6; i++) simd4_store(&adjugate->at[i][k], pivot_inverse[i] = scale * simd4_load(&adjugate->at[i][k]));
        for (int i = 0; i < 9; i++) c[i] = simd4_load(&chain->coupling.at[i][k]);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                const simd4 column[3] = {pivot_inverse[SYMMETRIC[0][j]], pivot_inverse[SYMMETRIC[1][j]], pivot_inverse[SYMMETRIC[2][j]]};
                simd4_store(&tangent->lower.at[3 * i + j][k + 1], c[i] * column[0] + c[3 + i] * column[1] + c[6 + i] * column[2]);
            }
    }
}

static inline row_matrix lower_at(const needle_tangent *tangent, int k) {
    row_matrix m;
    for (int i = 0; i < 3; i++) m.row[i] = (simd4){tangent->lower.at[3 * i][k], tangent->lower.at[3 * i + 1][k], tangent->lower.at[3 * i + 2][k], 0.0};
    return m;
}

static inline row_matrix pivot_inverse_at(const needle_tangent *tangent, int k) {
    row_matrix m;
    double x[6];
    for (int i = 0; i < 6; i++) x[i] = tangent->pivot_inverse.at[i][k];
    for (int i = 0; i < 3; i++) m.row[i] = (simd4){x[SYMMETRIC[i][0]], x[SYMMETRIC[i][1]], x[SYMMETRIC[i][2]], 0.0};
    return m;
}

/* Returns the moments on segments k to k + 3 that would cancel the moments at their joints if there were no load. */
static inline vec3_simd4 released_moments(const vector_series *moments, int k) {
    return v3l_sub(vectors_at(moments, k + 1), vectors_at(moments, k));
}

/* Solves the tangent system in place: `rotation` holds the moments on entry and the segments' rotations on return. */
static void solve_tangent(int n, const needle_tangent *tangent, vector_series *rotation) {
    const double (*lower)[NEEDLE_PLACES] = tangent->lower.at;
    double x = rotation->at[0][0], y = rotation->at[1][0], z = rotation->at[2][0];
    for (int k = 1; k < n; k++) {
        double next[3];
        for (int i = 0; i < 3; i++) rotation->at[i][k] = next[i] = rotation->at[i][k] - lower[3 * i][k] * x - lower[3 * i + 1][k] * y - lower[3 * i + 2][k] * z;
        x = next[0], y = next[1], z = next[2];
    }
    for (int k = 0; k < n; k += SIMD4_WIDTH) {
        vec3_simd4 r = vectors_at(rotation, k);
        simd4 s[6];
        for (int i = 0; i < 6; i++) s[i] = simd4_load(&tangent->pivot_inverse.at[i][k]);
        put_vectors(rotation, k, (vec3_simd4){s[0] * r.x + s[1] * r.y + s[2] * r.z, s[1] * r.x + s[3] * r.y + s[4] * r.z, s[2] * r.x + s[4] * r.y + s[5] * r.z});
    }
    x = rotation->at[0][n - 1], y = rotation->at[1][n - 1], z = rotation->at[2][n - 1];
    for (int k = n - 2; k >= 0; k--) {
        double next[3];
        for (int i = 0; i < 3; i++) rotation->at[i][k] = next[i] = rotation->at[i][k] - lower[i][k + 1] * x - lower[3 + i][k + 1] * y - lower[6 + i][k + 1] * z;
        x = next[0], y = next[1], z = next[2];
    }
}

/* Three rows of a matrix with three columns per joint. */
typedef double (*joint_rows)[NEEDLE_LD];
enum { BLOCK = 12 }; /* columns per block of four joints */

static void put_block(joint_rows rows, int joint, const mat3 *block) {
    for (int a = 0; a < 3; a++) memcpy(&rows[a][3 * joint], block->m[a], sizeof block->m[a]);
}

/* Computes to = own - m^T from in columns [begin, end), rounded out to whole blocks. `own` is repeated for every joint. */
static void carry_back(const row_matrix *own, const mat3 *m, joint_rows from, joint_rows to, int begin, int end) {
    simd4 added[3][BLOCK / SIMD4_WIDTH];
    for (int a = 0; a < 3; a++) {
        simd4 r = own->row[a];
        added[a][0] = __builtin_shufflevector(r, r, 0, 1, 2, 0);
        added[a][1] = __builtin_shufflevector(r, r, 1, 2, 0, 1);
        added[a][2] = __builtin_shufflevector(r, r, 2, 0, 1, 2);
    }
    for (int block = begin / BLOCK * BLOCK; block < end; block += BLOCK)
        for (int i = 0; i < BLOCK / SIMD4_WIDTH; i++) {
            int c = block + i * SIMD4_WIDTH;
            simd4 x = simd4_load(&from[0][c]), y = simd4_load(&from[1][c]), z = simd4_load(&from[2][c]);
            for (int a = 0; a < 3; a++) simd4_store(&to[a][c], added[a][i] - m->m[0][a] * x - m->m[1][a] * y - m->m[2][a] * z);
        }
}

/* Does the forward substitution of the right-hand sides. A force at a joint exerts the moment t x force on each segment before the joint, where t is the vector
   along the segment. */
static void substitute_forward(int n, const needle_tangent *tangent, rod_chain *chain) {
    vector_series released;
    for (int k = 0; k < n; k += SIMD4_WIDTH) put_vectors(&released, k, released_moments(&tangent->moments, k));
    for (int k = 0; k < n; k++) {
        vec3 t = vector_at(&chain->arm, k), r = vector_at(&released, k);
        row_matrix side = {{{0, -t.z, t.y, r.x}, {t.z, 0, -t.x, r.y}, {-t.y, t.x, 0, r.z}}};
        if (k > 0) side = rm_subtract(side, rm_multiply(lower_at(tangent, k), chain->sides[k - 1]));
        chain->sides[k] = side;
    }
}

/* Returns the displacement of joint `last` under forces on later joints, apart from the term that depends on the rotation of segment `last`. This is the sum of
   S^T P^-1 S over the segments before the joint, where P are the pivots and S the right-hand sides after forward substitution. The fourth column is for zero
   load. */
static row_matrix displace_base(int last, const needle_tangent *tangent, const rod_chain *chain) {
    row_matrix sum = {{{0}}};
    for (int k = 0; k < last; k++) sum = rm_add(sum, rm_multiply_transposed(chain->sides[k], rm_multiply(pivot_inverse_at(tangent, k), chain->sides[k])));
    return sum;
}

/* Computes the rotations of the segments from `last` on: one column for each unit force at a joint from `first` on, and `turn` for zero load. A force at a
   joint exerts no moment on later segments, which has two consequences. Forward substitution up to segment k is the same for all joints beyond k. And backward
   substitution can start with the segment just before the joint, using that segment's block of the inverse stiffness (`own`), which accounts for all later
   segments. */
static void find_rotations(int n, int first, int last, const row_matrix *sides, needle_tangent *tangent, vec3 *turn) {
    row_matrix own = {{{0}}};
    for (int k = n - 1; k >= last; k--) {
        joint_rows rows = &tangent->rotation[3 * k];
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

/* Computes the displacements of the joints from `last` + 1 on, by adding up rotation x segment vector, starting from the displacement of joint `last`. */
static void sum_displacements(int n, int first, int last, const vector_series *arm, joint_rows sum, needle_tangent *tangent) {
    int end = 3 * (n + 1);
    for (int k = last; k < n; k++) {
        vec3 t = vector_at(arm, k);
        joint_rows rotation = &tangent->rotation[3 * k], rows = &tangent->compliance[3 * (k + 1)];
        for (int c = simd4_below(3 * (k + 1 > first ? k + 1 : first)); c < end; c += SIMD4_WIDTH) {
            simd4 x = simd4_load(&rotation[0][c]), y = simd4_load(&rotation[1][c]), z = simd4_load(&rotation[2][c]);
            simd4 moved[3] = {y * t.z - z * t.y, z * t.x - x * t.z, x * t.y - y * t.x};
            for (int a = 0; a < 3; a++) {
                moved[a] += simd4_load(&sum[a][c]);
                simd4_store(&sum[a][c], moved[a]);
                simd4_store(&rows[a][c], moved[a]);
            }
        }
        int before = k + 2 - NEEDLE_POINT_JOINTS; /* earliest joint that can share a centreline point with joint k + 1 */
        for (int c = 3 * (before > first ? before : first); c < 3 * (k + 1); c++) /* from symmetry */
            for (int a = 0; a < 3; a++) rows[a][c] = tangent->compliance[c][3 * (k + 1) + a];
    }
}

/* Computes the compliance for the joints from `first` on, and where they would drift under zero load. */
static void find_compliance(int n, int first, const rod_chain *chain, needle_tangent *tangent) {
    int last = first > 1 ? first - 1 : 0; /* all joints of interest lie beyond the start of this segment */
    vec3 turn[NEEDLE_MAX_SEGMENTS], *drift = tangent->drift;
    double sum[3][NEEDLE_LD] = {{0}};
    for (int a = 0; a < 3 && first == 0; a++)
        for (int c = 0; c < 3 * (n + 1); c++) tangent->compliance[a][c] = tangent->compliance[c][a] = 0.0; /* the base is fixed */
    find_rotations(n, first, last, chain->sides, tangent, turn);
    drift[last] = v3(0, 0, 0);
    if (last > 0) {
        row_matrix base = displace_base(last, tangent, chain);
        mat3 by_turn = matrix_of(rm_multiply(lower_at(tangent, last), chain->sides[last - 1]));
        carry_back(&base, &by_turn, &tangent->rotation[3 * last], sum, 3 * first, 3 * (n + 1));
        drift[last] = v3_sub(v3(base.row[0][3], base.row[1][3], base.row[2][3]), m3_apply_transposed(&by_turn, turn[last]));
    }
    for (int k = last; k < n; k++) drift[k + 1] = v3_add(drift[k], v3_cross(turn[k], vector_at(&chain->arm, k)));
    sum_displacements(n, first, last, &chain->arm, sum, tangent);
}

void rod_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent) {
    int n = model->given.segments;
    rod_chain chain;
    assemble_chain(model, state, load, &chain, tangent);
    factor_tangent(n, &chain, tangent);
    substitute_forward(n, tangent, &chain);
    find_compliance(n, first, &chain, tangent);
}

double rod_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state) {
    int n = model->given.segments;
    vector_series beyond, rotation;
    rod_frames of;
    rod_copy_frames(n, state, &of);
    sum_loads(n, load, &beyond);
    for (int k = 0; k < n; k += SIMD4_WIDTH) {
        vec3_simd4 released = released_moments(&tangent->moments, k), arm = arms_of(model, &of, k);
        put_vectors(&rotation, k, v3l_add(released, v3l_cross(arm, vectors_at(&beyond, k))));
    }
    solve_tangent(n, tangent, &rotation);
    double largest = 0.0;
    for (int k = 0; k < n; k += SIMD4_WIDTH) {
        vec3_simd4 r = vectors_at(&rotation, k);
        simd4 angle2 = v3l_dot(r, r);
        for (int i = 0; i < SIMD4_WIDTH && k + i < n; i++) largest = fmax(largest, angle2[i]);
        ql_store(rod_frame(&of, k), ql_unit(ql_multiply(ql_exp(r), frames_at(&of, k))));
    }
    rod_set_frames(model, &of, state);
    return sqrt(largest);
}

/* ---- going on ------------------------------------------------------------------------------------------------------ */

/* Returns `fraction` of a small rotation, to first order. */
static quat_simd4 part_of(quat_simd4 turn, simd4 fraction) {
    simd4 w = fraction * simd4_signs(turn.w); /* a negative w means the long way round; flip the sign to take the short one */
    return ql_unit((quat_simd4){simd4_all(1.0), w * turn.x, w * turn.y, w * turn.z});
}

void rod_extrapolate(const needle_model *model, const needle_motion *motion, double fraction, needle_state *state) {
    rod_frames of;
    rod_copy_frames(model->given.segments, state, &of);
    for (int k = 0; k < model->given.segments; k += SIMD4_WIDTH)
        ql_store(rod_frame(&of, k), ql_multiply(part_of(ql_load(&motion->turn[k]), simd4_all(fraction)), frames_at(&of, k)));
    rod_set_frames(model, &of, state);
}
