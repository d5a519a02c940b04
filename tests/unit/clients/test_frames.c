/* Tests docs/examples/frames.h, which converts between device frames and the scene's world frame. */
#include <stdlib.h>
#include <string.h>
#include "../docs/examples/frames.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "base/vec.h"

static const frame toward_z = {FRAME_Z_TOWARD_OPERATOR, {0.1, 0.2, 0.3}}, toward_x = {FRAME_X_TOWARD_OPERATOR, {0.1, 0.2, 0.3}};

static void expect(const double a[], double x, double y, double z) {
    assert_float_equal(a[0], x, 1e-15);
    assert_float_equal(a[1], y, 1e-15);
    assert_float_equal(a[2], z, 1e-15);
}

/* Away from the operator is into the body, up stays up, and x points to the operator's left. */
static void directions(void **state) {
    (void)state;
    double level[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, base[3], q[4], force[3];
    pose_in_world(&toward_z, (double[]){0, 0, -0.05}, level, base, q);
    expect(base, 0.1, 0.2, 0.35);
    assert_float_equal(fabs(q[0]), 1, 1e-15);
    pose_in_world(&toward_z, (double[]){-0.01, 0.02, 0}, level, base, q);
    expect(base, 0.11, 0.22, 0.3);
    pose_in_world(&toward_x, (double[]){-0.05, -0.01, 0.02}, level, base, q);
    expect(base, 0.11, 0.22, 0.35);
    assert_float_equal(fabs(q[0]), 1, 1e-15);
    vector_on_device(&toward_z, (double[]){0, 0, -1}, force); /* a vector out of the body points toward the operator */
    expect(force, 0, 0, 1);
    vector_on_device(&toward_x, (double[]){0, 0, -1}, force);
    expect(force, 1, 0, 0);
}

/* If a stylus points 30 degrees upward, so does the needle's axis, which is its local z axis. */
static void a_tilted_stylus(void **state) {
    (void)state;
    double c = cos(M_PI / 6), s = sin(M_PI / 6), base[3], q[4];
    double about_x[3][3] = {{1, 0, 0}, {0, c, -s}, {0, s, c}}, about_y[3][3] = {{c, 0, s}, {0, 1, 0}, {-s, 0, c}};
    pose_in_world(&toward_z, (double[]){0, 0, 0}, about_x, base, q); /* -z turns up */
    vec3 axis = q_rotate((quat){q[0], q[1], q[2], q[3]}, v3(0, 0, 1));
    expect((double[]){axis.x, axis.y, axis.z}, 0, s, c);
    pose_in_world(&toward_x, (double[]){0, 0, 0}, about_y, base, q); /* -x turns up */
    axis = q_rotate((quat){q[0], q[1], q[2], q[3]}, v3(0, 0, 1));
    expect((double[]){axis.x, axis.y, axis.z}, 0, s, c);
}

/* Converts quaternions to matrices and back, including half turns about each axis. */
static void quaternions(void **state) {
    (void)state;
    srand(1);
    for (int trial = 0; trial < 10000; trial++) {
        double q[4], back[4], m[3][3], norm = 0;
        for (int i = 0; i < 4; i++) q[i] = trial < 4 ? i == trial : 2.0 * rand() / RAND_MAX - 1, norm += q[i] * q[i];
        for (int i = 0; i < 4; i++) q[i] /= sqrt(norm);
        for (int j = 0; j < 3; j++) {
            vec3 column = q_rotate((quat){q[0], q[1], q[2], q[3]}, v3(j == 0, j == 1, j == 2));
            m[0][j] = column.x, m[1][j] = column.y, m[2][j] = column.z;
        }
        quaternion_of_matrix(m, back);
        double dot = 0;
        for (int i = 0; i < 4; i++) dot += q[i] * back[i];
        assert_float_equal(fabs(dot), 1, 1e-14);
    }
}

/* The hand repeatedly moves 40 mm forward, then back with the clutch pressed. At a scale of 2, each forward stroke moves the needle by 80 mm. */
static void a_clutch_adds_strokes(void **state) {
    (void)state;
    hand_map m = {.scale = 2, .force_scale = 0.5};
    double needle[3], force[3];
    for (int stroke = 0; stroke < 3; stroke++) {
        for (int i = 0; i <= 40; i++) {
            map_hand(&m, 0, (double[]){0, 0, 1e-3 * i}, needle);
            assert_float_equal(needle[2], 80e-3 * stroke + 2e-3 * i, 1e-12);
        }
        for (int i = 40; i >= 0; i--) {
            map_hand(&m, 1, (double[]){1e-3 * i, 0, 1e-3 * i}, needle);
            expect((double[]){needle[0], needle[1], needle[2] - 80e-3 * (stroke + 1)}, 0, 0, 0);
            map_force(&m, memcpy(force, (double[]){1, 2, 3}, sizeof force));
            expect(force, 0, 0, 0);
        }
    }
    double before = 0;
    for (int i = 0; i < 100; i++) { /* the force comes back without a jump */
        map_hand(&m, 0, (double[]){0, 0, 0}, needle);
        map_force(&m, memcpy(force, (double[]){0, 0, 2}, sizeof force));
        assert_true(force[2] > before && force[2] - before < 0.011);
        before = force[2];
    }
    assert_float_equal(before, 1, 1e-12);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(directions), cmocka_unit_test(a_tilted_stylus), cmocka_unit_test(quaternions),
                                       cmocka_unit_test(a_clutch_adds_strokes)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
