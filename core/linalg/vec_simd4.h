/* The operations of vec.h for four vectors, rotations or matrices at once, one in each lane. */
#ifndef TROCAR_VEC_SIMD4_H
#define TROCAR_VEC_SIMD4_H

#include "linalg/simd4.h"
#include "base/vec.h"

typedef struct { simd4 x, y, z; } vec3_simd4;
typedef struct { simd4 w, x, y, z; } quat_simd4;
typedef struct { simd4 m[3][3]; } mat3_simd4;   /* m[row][column] */

static inline simd4 simd4_sqrt(simd4 a) { return (simd4){sqrt(a[0]), sqrt(a[1]), sqrt(a[2]), sqrt(a[3])}; }
static inline simd4 simd4_signs(simd4 a) { return (simd4){copysign(1.0, a[0]), copysign(1.0, a[1]), copysign(1.0, a[2]), copysign(1.0, a[3])}; }

/* Transposes four vectors: rows become columns. */
static inline void simd4_transpose(simd4 *a, simd4 *b, simd4 *c, simd4 *d) {
    simd4 ab = __builtin_shufflevector(*a, *b, 0, 4, 2, 6), ba = __builtin_shufflevector(*a, *b, 1, 5, 3, 7);
    simd4 cd = __builtin_shufflevector(*c, *d, 0, 4, 2, 6), dc = __builtin_shufflevector(*c, *d, 1, 5, 3, 7);
    *a = __builtin_shufflevector(ab, cd, 0, 1, 4, 5);
    *b = __builtin_shufflevector(ba, dc, 0, 1, 4, 5);
    *c = __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
    *d = __builtin_shufflevector(ba, dc, 2, 3, 6, 7);
}

static inline simd4 v3l_dot(vec3_simd4 a, vec3_simd4 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline vec3_simd4 v3l_add(vec3_simd4 a, vec3_simd4 b) { return (vec3_simd4){a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline vec3_simd4 v3l_sub(vec3_simd4 a, vec3_simd4 b) { return (vec3_simd4){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline vec3_simd4 v3l_scale(simd4 s, vec3_simd4 a) { return (vec3_simd4){s * a.x, s * a.y, s * a.z}; }
static inline vec3_simd4 v3l_axpy(simd4 s, vec3_simd4 a, vec3_simd4 b) { return (vec3_simd4){s * a.x + b.x, s * a.y + b.y, s * a.z + b.z}; }
static inline vec3_simd4 v3l_cross(vec3_simd4 a, vec3_simd4 b) {
    return (vec3_simd4){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
static inline vec3_simd4 v3l_unit(vec3_simd4 a) { return v3l_scale(1.0 / simd4_sqrt(v3l_dot(a, a)), a); }

static inline simd4 quat_row(const quat *q) {
    simd4 x;
    memcpy(&x, q, sizeof x);
    return x;
}
static inline quat_simd4 ql_load(const quat from[SIMD4_WIDTH]) {
    quat_simd4 q = {quat_row(&from[0]), quat_row(&from[1]), quat_row(&from[2]), quat_row(&from[3])};
    simd4_transpose(&q.w, &q.x, &q.y, &q.z);
    return q;
}
static inline quat_simd4 ql_gather(const quat *from, const int places[SIMD4_WIDTH]) {
    quat_simd4 q = {quat_row(&from[places[0]]), quat_row(&from[places[1]]), quat_row(&from[places[2]]), quat_row(&from[places[3]])};
    simd4_transpose(&q.w, &q.x, &q.y, &q.z);
    return q;
}
static inline void ql_store(quat to[SIMD4_WIDTH], quat_simd4 q) {
    simd4_transpose(&q.w, &q.x, &q.y, &q.z);
    memcpy(&to[0], &q.w, sizeof *to);
    memcpy(&to[1], &q.x, sizeof *to);
    memcpy(&to[2], &q.y, sizeof *to);
    memcpy(&to[3], &q.z, sizeof *to);
}
static inline quat_simd4 ql_multiply(quat_simd4 a, quat_simd4 b) {
    return (quat_simd4){a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
                        a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
                        a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
                        a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}
static inline quat_simd4 ql_conjugate(quat_simd4 q) { return (quat_simd4){q.w, -q.x, -q.y, -q.z}; }
static inline quat_simd4 ql_unit(quat_simd4 q) {
    simd4 s = 1.0 / simd4_sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    return (quat_simd4){s * q.w, s * q.x, s * q.y, s * q.z};
}
static inline vec3_simd4 ql_axis_x(quat_simd4 q) {
    return (vec3_simd4){1.0 - 2.0 * (q.y * q.y + q.z * q.z), 2.0 * (q.x * q.y + q.w * q.z), 2.0 * (q.x * q.z - q.w * q.y)};
}
static inline vec3_simd4 ql_axis_y(quat_simd4 q) {
    return (vec3_simd4){2.0 * (q.x * q.y - q.w * q.z), 1.0 - 2.0 * (q.x * q.x + q.z * q.z), 2.0 * (q.y * q.z + q.w * q.x)};
}
static inline vec3_simd4 ql_axis(quat_simd4 q) {
    return (vec3_simd4){2.0 * (q.x * q.z + q.w * q.y), 2.0 * (q.y * q.z - q.w * q.x), 1.0 - 2.0 * (q.x * q.x + q.y * q.y)};
}

static inline quat_simd4 ql_exp(vec3_simd4 r) {
    simd4 half2 = 0.25 * v3l_dot(r, r);
    simd4 s = 0.5 + half2 * (-1.0 / 12 + half2 * (1.0 / 240 + half2 * (-1.0 / 10080 + half2 * (1.0 / 725760))));
    simd4 c = 1.0 + half2 * (-1.0 / 2 + half2 * (1.0 / 24 + half2 * (-1.0 / 720 + half2 * (1.0 / 40320))));
    for (int i = 0; i < SIMD4_WIDTH; i++) {
        if (half2[i] < 1e-3) continue;
        double half = sqrt(half2[i]);
        s[i] = 0.5 * sin(half) / half;
        c[i] = cos(half);
    }
    return (quat_simd4){c, s * r.x, s * r.y, s * r.z};
}
static inline vec3_simd4 ql_log(quat_simd4 q) {
    simd4 sign = simd4_signs(q.w), s2 = q.x * q.x + q.y * q.y + q.z * q.z;
    simd4 scale = 2.0 + s2 * (1.0 / 3 + s2 * (3.0 / 20 + s2 * (5.0 / 56 + s2 * (35.0 / 576 + s2 * (63.0 / 1408)))));
    for (int i = 0; i < SIMD4_WIDTH; i++)
        if (!(s2[i] < 1e-3)) scale[i] = 2.0 * atan2(sqrt(s2[i]), fabs(q.w[i])) / sqrt(s2[i]);
    return v3l_scale(sign * scale, (vec3_simd4){q.x, q.y, q.z});
}

#endif
