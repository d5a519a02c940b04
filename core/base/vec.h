/* Small vectors, matrices and rotations, passed by value. Frames are right-handed, angles in rad. */
#ifndef TROCAR_VEC_H
#define TROCAR_VEC_H

#include <math.h>
#include <stdbool.h>

typedef struct { double x, y, z; } vec3;
typedef struct { double m[3][3]; } mat3;       /* m[row][column] */
typedef struct { double w, x, y, z; } quat;    /* unit quaternion; rotates from body to world coordinates */
typedef struct { vec3 position; quat orientation; } pose;

/* Like fmax and fmin, but without a library call. If either argument is NaN, they return b. */
static inline double larger_of(double a, double b) { return a > b ? a : b; }
static inline double smaller_of(double a, double b) { return a < b ? a : b; }

/* Interpolates linearly. Exact at both ends and between equal values, even infinite ones. RT */
static inline double value_between(double from, double to, double part) { return from == to ? to : part == 1.0 ? to : from + part * (to - from); }

static inline vec3 v3(double x, double y, double z) { return (vec3){x, y, z}; }
static inline vec3 v3_add(vec3 a, vec3 b) { return v3(a.x + b.x, a.y + b.y, a.z + b.z); }
static inline vec3 v3_sub(vec3 a, vec3 b) { return v3(a.x - b.x, a.y - b.y, a.z - b.z); }
static inline vec3 v3_scale(double s, vec3 a) { return v3(s * a.x, s * a.y, s * a.z); }
static inline vec3 v3_axpy(double s, vec3 a, vec3 b) { return v3(s * a.x + b.x, s * a.y + b.y, s * a.z + b.z); }
static inline bool v3_same(vec3 a, vec3 b) { return a.x == b.x && a.y == b.y && a.z == b.z; }
static inline double v3_dot(vec3 a, vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline vec3 v3_cross(vec3 a, vec3 b) {
    return v3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
static inline double v3_norm(vec3 a) { return sqrt(v3_dot(a, a)); }
static inline vec3 v3_unit(vec3 a) { return v3_scale(1.0 / v3_norm(a), a); }

static inline vec3 m3_apply(const mat3 *a, vec3 v) {
    return v3(a->m[0][0] * v.x + a->m[0][1] * v.y + a->m[0][2] * v.z,
              a->m[1][0] * v.x + a->m[1][1] * v.y + a->m[1][2] * v.z,
              a->m[2][0] * v.x + a->m[2][1] * v.y + a->m[2][2] * v.z);
}
static inline vec3 m3_apply_transposed(const mat3 *a, vec3 v) {
    return v3(a->m[0][0] * v.x + a->m[1][0] * v.y + a->m[2][0] * v.z,
              a->m[0][1] * v.x + a->m[1][1] * v.y + a->m[2][1] * v.z,
              a->m[0][2] * v.x + a->m[1][2] * v.y + a->m[2][2] * v.z);
}
static inline mat3 m3_multiply(const mat3 *a, const mat3 *b) {
    mat3 c;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            c.m[i][j] = a->m[i][0] * b->m[0][j] + a->m[i][1] * b->m[1][j] + a->m[i][2] * b->m[2][j];
    return c;
}
static inline mat3 m3_transposed(const mat3 *a) {
    mat3 t;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) t.m[i][j] = a->m[j][i];
    return t;
}
static inline mat3 m3_scaled(double s, mat3 a) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) a.m[i][j] *= s;
    return a;
}
static inline double m3_determinant(const mat3 *a) {
    return a->m[0][0] * (a->m[1][1] * a->m[2][2] - a->m[1][2] * a->m[2][1])
         - a->m[0][1] * (a->m[1][0] * a->m[2][2] - a->m[1][2] * a->m[2][0])
         + a->m[0][2] * (a->m[1][0] * a->m[2][1] - a->m[1][1] * a->m[2][0]);
}
/* Computes the inverse from cofactors; the determinant must not be zero. */
static inline mat3 m3_inverse(const mat3 *a) {
    double s = 1.0 / m3_determinant(a);
    mat3 b;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int r = (j + 1) % 3, q = (j + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
            b.m[i][j] = s * (a->m[r][c] * a->m[q][d] - a->m[r][d] * a->m[q][c]);
        }
    return b;
}
/* Computes sum += s * block, where `block` is a 3 x 3 block of a matrix with row length ld. */
static inline void m3_add_block(mat3 *sum, double s, const double *block, int ld) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) sum->m[i][j] += s * block[i * ld + j];
}
static inline void m3_add_scaled(mat3 *sum, double s, const mat3 *a) { m3_add_block(sum, s, &a->m[0][0], 3); }
static inline vec3 m3_column(const mat3 *a, int j) { return v3(a->m[0][j], a->m[1][j], a->m[2][j]); }
/* Returns the matrix whose columns are a, b and c. */
static inline mat3 m3_columns(vec3 a, vec3 b, vec3 c) {
    return (mat3){{{a.x, b.x, c.x}, {a.y, b.y, c.y}, {a.z, b.z, c.z}}};
}

/* Like hypot(), but without its protection against overflow, which would take most of the time. */
static inline double length_of(double x, double y) { return sqrt(x * x + y * y); }

/* Returns a matrix whose columns are an orthonormal frame, with the unit vector `direction` as the third axis. */
static inline mat3 frame_along(vec3 direction) {
    vec3 aside = fabs(direction.x) < 0.6 ? v3(1, 0, 0) : v3(0, 1, 0), x = v3_unit(v3_cross(aside, direction));
    return m3_columns(x, v3_cross(direction, x), direction);
}

static inline quat q_multiply(quat a, quat b) {
    return (quat){a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
                  a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
                  a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
                  a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}
static inline quat q_conjugate(quat q) { return (quat){q.w, -q.x, -q.y, -q.z}; }
static inline quat q_unit(quat q) {
    double s = 1.0 / sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    return (quat){s * q.w, s * q.x, s * q.y, s * q.z};
}
static inline vec3 q_rotate(quat q, vec3 v) {
    vec3 u = v3(q.x, q.y, q.z), t = v3_scale(2.0, v3_cross(u, v));
    return v3_add(v3_axpy(q.w, t, v), v3_cross(u, t));
}
/* Return the body's x, y and z axes in world coordinates; a needle points along its z axis. */
static inline vec3 q_axis_x(quat q) { return v3(1.0 - 2.0 * (q.y * q.y + q.z * q.z), 2.0 * (q.x * q.y + q.w * q.z), 2.0 * (q.x * q.z - q.w * q.y)); }
static inline vec3 q_axis_y(quat q) { return v3(2.0 * (q.x * q.y - q.w * q.z), 1.0 - 2.0 * (q.x * q.x + q.z * q.z), 2.0 * (q.y * q.z + q.w * q.x)); }
static inline vec3 q_axis(quat q) { return v3(2.0 * (q.x * q.z + q.w * q.y), 2.0 * (q.y * q.z - q.w * q.x), 1.0 - 2.0 * (q.x * q.x + q.y * q.y)); }
static inline mat3 q_matrix(quat q) { return m3_columns(q_axis_x(q), q_axis_y(q), q_axis(q)); }
/* Returns the rotation for the rotation vector `r` (axis times angle). Small angles use a series that is accurate to the last digit. */
static inline quat q_exp(vec3 r) {
    double half2 = 0.25 * v3_dot(r, r), s, c;
    if (half2 < 1e-3) {
        s = 0.5 + half2 * (-1.0 / 12 + half2 * (1.0 / 240 + half2 * (-1.0 / 10080 + half2 * (1.0 / 725760))));
        c = 1.0 + half2 * (-1.0 / 2 + half2 * (1.0 / 24 + half2 * (-1.0 / 720 + half2 * (1.0 / 40320))));
    } else {
        double half = sqrt(half2);
        s = 0.5 * sin(half) / half;
        c = cos(half);
    }
    return (quat){c, s * r.x, s * r.y, s * r.z};
}
/* Returns the rotation vector (axis times angle) of `q`, with an angle in [0, pi]. */
static inline vec3 q_log(quat q) {
    if (q.w < 0) q = (quat){-q.w, -q.x, -q.y, -q.z};
    double s2 = q.x * q.x + q.y * q.y + q.z * q.z, scale;
    if (s2 < 1e-3) /* series of 2 asin(s) / s, where s is the length of the quaternion's vector part */
        scale = 2.0 + s2 * (1.0 / 3 + s2 * (3.0 / 20 + s2 * (5.0 / 56 + s2 * (35.0 / 576 + s2 * (63.0 / 1408)))));
    else
        scale = 2.0 * atan2(sqrt(s2), q.w) / sqrt(s2);
    return v3(scale * q.x, scale * q.y, scale * q.z);
}

/* Converts a rotation matrix to a unit quaternion. Each row of `rows` is a multiple of the quaternion; the one with the largest diagonal entry is the most
   accurate. */
static inline quat q_of_matrix(const mat3 *turn) {
    const double (*m)[3] = turn->m;
    const double rows[4][4] = {{1 + m[0][0] + m[1][1] + m[2][2], m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]},
                               {m[2][1] - m[1][2], 1 + m[0][0] - m[1][1] - m[2][2], m[0][1] + m[1][0], m[0][2] + m[2][0]},
                               {m[0][2] - m[2][0], m[0][1] + m[1][0], 1 - m[0][0] + m[1][1] - m[2][2], m[1][2] + m[2][1]},
                               {m[1][0] - m[0][1], m[0][2] + m[2][0], m[1][2] + m[2][1], 1 - m[0][0] - m[1][1] + m[2][2]}};
    int best = 0;
    for (int i = 1; i < 4; i++)
        if (rows[i][i] > rows[best][best]) best = i;
    return q_unit((quat){rows[best][0], rows[best][1], rows[best][2], rows[best][3]});
}

/* Returns the rotation (rad) about the body's z axis from one orientation to another; exactly 0 between equal orientations. */
static inline double q_roll_between(quat from, quat to) {
    if (from.w == to.w && from.x == to.x && from.y == to.y && from.z == to.z) return 0.0;
    return v3_dot(q_log(q_multiply(to, q_conjugate(from))), q_axis(from));
}

/* Interpolates between two poses: positions linearly, orientations by rotating about a fixed axis. */
static inline pose pose_between(pose from, pose to, double fraction) {
    vec3 turn = q_log(q_multiply(to.orientation, q_conjugate(from.orientation)));
    return (pose){v3_axpy(fraction, v3_sub(to.position, from.position), from.position),
                  q_unit(q_multiply(q_exp(v3_scale(fraction, turn)), from.orientation))};
}

#endif
