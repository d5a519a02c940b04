/* Four vectors, rotations or matrices at once, one in each lane; the operations of vec.h. */
#ifndef TROCAR_VEC_LANES_H
#define TROCAR_VEC_LANES_H

#include "base/lanes.h"
#include "base/vec.h"

typedef struct { lanes x, y, z; } vec3_lanes;
typedef struct { lanes w, x, y, z; } quat_lanes;
typedef struct { lanes m[3][3]; } mat3_lanes;   /* m[row][column] */

static inline lanes lanes_sqrt(lanes a) { return (lanes){sqrt(a[0]), sqrt(a[1]), sqrt(a[2]), sqrt(a[3])}; }
static inline lanes lanes_signs(lanes a) { return (lanes){copysign(1.0, a[0]), copysign(1.0, a[1]), copysign(1.0, a[2]), copysign(1.0, a[3])}; }

/* Rows become columns. */
static inline void lanes_transpose(lanes *a, lanes *b, lanes *c, lanes *d) {
    lanes ab = __builtin_shufflevector(*a, *b, 0, 4, 2, 6), ba = __builtin_shufflevector(*a, *b, 1, 5, 3, 7);
    lanes cd = __builtin_shufflevector(*c, *d, 0, 4, 2, 6), dc = __builtin_shufflevector(*c, *d, 1, 5, 3, 7);
    *a = __builtin_shufflevector(ab, cd, 0, 1, 4, 5);
    *b = __builtin_shufflevector(ba, dc, 0, 1, 4, 5);
    *c = __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
    *d = __builtin_shufflevector(ba, dc, 2, 3, 6, 7);
}

static inline lanes v3l_dot(vec3_lanes a, vec3_lanes b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline vec3_lanes v3l_add(vec3_lanes a, vec3_lanes b) { return (vec3_lanes){a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline vec3_lanes v3l_sub(vec3_lanes a, vec3_lanes b) { return (vec3_lanes){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline vec3_lanes v3l_scale(lanes s, vec3_lanes a) { return (vec3_lanes){s * a.x, s * a.y, s * a.z}; }
static inline vec3_lanes v3l_axpy(lanes s, vec3_lanes a, vec3_lanes b) { return (vec3_lanes){s * a.x + b.x, s * a.y + b.y, s * a.z + b.z}; }
static inline vec3_lanes v3l_cross(vec3_lanes a, vec3_lanes b) {
    return (vec3_lanes){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
static inline vec3_lanes v3l_unit(vec3_lanes a) { return v3l_scale(1.0 / lanes_sqrt(v3l_dot(a, a)), a); }

/* a b */
static inline mat3_lanes m3l_multiply(const mat3_lanes *a, const mat3_lanes *b) {
    mat3_lanes c;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) c.m[i][j] = a->m[i][0] * b->m[0][j] + a->m[i][1] * b->m[1][j] + a->m[i][2] * b->m[2][j];
    return c;
}

static inline lanes quat_row(const quat *q) {
    lanes x;
    memcpy(&x, q, sizeof x);
    return x;
}
static inline quat_lanes ql_load(const quat from[LANES]) {
    quat_lanes q = {quat_row(&from[0]), quat_row(&from[1]), quat_row(&from[2]), quat_row(&from[3])};
    lanes_transpose(&q.w, &q.x, &q.y, &q.z);
    return q;
}
static inline quat_lanes ql_gather(const quat *from, const int places[LANES]) {
    quat_lanes q = {quat_row(&from[places[0]]), quat_row(&from[places[1]]), quat_row(&from[places[2]]), quat_row(&from[places[3]])};
    lanes_transpose(&q.w, &q.x, &q.y, &q.z);
    return q;
}
static inline void ql_store(quat to[LANES], quat_lanes q) {
    lanes_transpose(&q.w, &q.x, &q.y, &q.z);
    memcpy(&to[0], &q.w, sizeof *to);
    memcpy(&to[1], &q.x, sizeof *to);
    memcpy(&to[2], &q.y, sizeof *to);
    memcpy(&to[3], &q.z, sizeof *to);
}
static inline quat_lanes ql_multiply(quat_lanes a, quat_lanes b) {
    return (quat_lanes){a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
                        a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
                        a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
                        a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}
static inline quat_lanes ql_conjugate(quat_lanes q) { return (quat_lanes){q.w, -q.x, -q.y, -q.z}; }
static inline quat_lanes ql_unit(quat_lanes q) {
    lanes s = 1.0 / lanes_sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    return (quat_lanes){s * q.w, s * q.x, s * q.y, s * q.z};
}
static inline vec3_lanes ql_axis_x(quat_lanes q) {
    return (vec3_lanes){1.0 - 2.0 * (q.y * q.y + q.z * q.z), 2.0 * (q.x * q.y + q.w * q.z), 2.0 * (q.x * q.z - q.w * q.y)};
}
static inline vec3_lanes ql_axis_y(quat_lanes q) {
    return (vec3_lanes){2.0 * (q.x * q.y - q.w * q.z), 1.0 - 2.0 * (q.x * q.x + q.z * q.z), 2.0 * (q.y * q.z + q.w * q.x)};
}
static inline vec3_lanes ql_axis(quat_lanes q) {
    return (vec3_lanes){2.0 * (q.x * q.z + q.w * q.y), 2.0 * (q.y * q.z - q.w * q.x), 1.0 - 2.0 * (q.x * q.x + q.y * q.y)};
}

static inline quat_lanes ql_exp(vec3_lanes r) {
    lanes half2 = 0.25 * v3l_dot(r, r);
    lanes s = 0.5 + half2 * (-1.0 / 12 + half2 * (1.0 / 240 + half2 * (-1.0 / 10080 + half2 * (1.0 / 725760))));
    lanes c = 1.0 + half2 * (-1.0 / 2 + half2 * (1.0 / 24 + half2 * (-1.0 / 720 + half2 * (1.0 / 40320))));
    for (int i = 0; i < LANES; i++) {
        if (half2[i] < 1e-3) continue;
        double half = sqrt(half2[i]);
        s[i] = 0.5 * sin(half) / half;
        c[i] = cos(half);
    }
    return (quat_lanes){c, s * r.x, s * r.y, s * r.z};
}
static inline vec3_lanes ql_log(quat_lanes q) {
    lanes sign = lanes_signs(q.w), s2 = q.x * q.x + q.y * q.y + q.z * q.z;
    lanes scale = 2.0 + s2 * (1.0 / 3 + s2 * (3.0 / 20 + s2 * (5.0 / 56 + s2 * (35.0 / 576 + s2 * (63.0 / 1408)))));
    for (int i = 0; i < LANES; i++)
        if (!(s2[i] < 1e-3)) scale[i] = 2.0 * atan2(sqrt(s2[i]), fabs(q.w[i])) / sqrt(s2[i]);
    return v3l_scale(sign * scale, (vec3_lanes){q.x, q.y, q.z});
}

#endif
