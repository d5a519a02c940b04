#include "needle/centreline_kernels.h"

#include "linalg/row_matrix.h"
#include "linalg/vec_simd4.h"

_Static_assert((int)CENTRELINE_STEP == SIMD4_WIDTH, "a step is one vector");

/* Stores the frames of the points. n1, n2, n3: the three axes of each frame, one point per SIMD lane. */
static void put_frames(needle_point *const *points, int count, vec3_simd4 n1, vec3_simd4 n2, vec3_simd4 n3) {
    simd4 x[SIMD4_WIDTH] = {n1.x, n2.x, n3.x, n3.x}, y[SIMD4_WIDTH] = {n1.y, n2.y, n3.y, n3.y}, z[SIMD4_WIDTH] = {n1.z, n2.z, n3.z, n3.z};
    simd4_transpose(&x[0], &x[1], &x[2], &x[3]);
    simd4_transpose(&y[0], &y[1], &y[2], &y[3]);
    simd4_transpose(&z[0], &z[1], &z[2], &z[3]);
    for (int i = 0; i < count; i++) points[i]->frame = matrix_of((row_matrix){{x[i], y[i], z[i]}});
}

void centreline_frames(const quat *segments, const int before[CENTRELINE_STEP], const int after[CENTRELINE_STEP], const double fraction[CENTRELINE_STEP],
                       int count, needle_point *const *points) {
    simd4 way = simd4_load(fraction);
    quat_simd4 here = ql_gather(segments, before), next = ql_gather(segments, after);
    vec3_simd4 y = ql_axis_y(next), n3 = v3l_unit(v3l_axpy(way, ql_axis(next), v3l_scale(1.0 - way, ql_axis(here))));
    vec3_simd4 n2 = v3l_unit(v3l_axpy(-v3l_dot(y, n3), n3, y));
    put_frames(points, count, v3l_cross(n2, n3), n2, n3);
}
