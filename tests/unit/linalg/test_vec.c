/* Compares vectors, matrices and rotations with textbook formulas. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include "linalg/vec_simd4.h"

#include <cmocka.h>

#include "check.h"

static double uniform(void) { return 2.0 * rand() / RAND_MAX - 1.0; }
static vec3 random_vector(void) { return v3(uniform(), uniform(), uniform()); }

static mat3 random_matrix(void) {
    vec3 a = random_vector(), b = random_vector(), c = random_vector();
    return m3_columns(a, b, c);
}

static void check_same_matrix(const mat3 *a, const mat3 *b, double tolerance, int line) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) check_close(a->m[i][j], b->m[i][j], tolerance, line);
}
#define assert_same_matrix(a, b, tolerance) check_same_matrix(a, b, tolerance, __LINE__)

static const mat3 UNIT = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

/* Returns a rotation by Rodrigues' formula, R = 1 + sin(angle) K + (1 - cos(angle)) K^2, where K is the cross product with the axis. */
static mat3 rodrigues(vec3 axis, double angle) {
    mat3 k = {{{0, -axis.z, axis.y}, {axis.z, 0, -axis.x}, {-axis.y, axis.x, 0}}}, r = UNIT;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double square = 0.0;
            for (int l = 0; l < 3; l++) square += k.m[i][l] * k.m[l][j];
            r.m[i][j] += sin(angle) * k.m[i][j] + (1.0 - cos(angle)) * square;
        }
    return r;
}

static void products_follow_the_right_hand(void **state) {
    (void)state;
    assert_close_vector(v3_cross(v3(1, 0, 0), v3(0, 1, 0)), v3(0, 0, 1), 0.0);
    assert_close_vector(v3_axpy(2.0, v3(1, 2, 3), v3(-1, 0, 1)), v3(1, 4, 7), 0.0);
    assert_close(v3_dot(v3(1, 2, 3), v3(4, -5, 6)), 12.0, 0.0);
    assert_close_vector(v3_unit(v3(0, 3, 4)), v3(0, 0.6, 0.8), 1e-15);
    for (int i = 0; i < 100; i++) {
        vec3 a = random_vector(), b = random_vector(), c = v3_cross(a, b);
        assert_close(v3_dot(a, c), 0.0, 1e-15);
        assert_close(v3_dot(c, c), v3_dot(a, a) * v3_dot(b, b) - v3_dot(a, b) * v3_dot(a, b), 1e-14); /* Lagrange */
    }
}

static void matrices_have_columns_and_rows(void **state) {
    (void)state;
    mat3 a = m3_columns(v3(1, 2, 3), v3(4, 5, 6), v3(7, 8, 10)), t = m3_transposed(&a);
    assert_close_vector(m3_apply(&a, v3(0, 1, 0)), v3(4, 5, 6), 0.0);
    assert_close_vector(m3_apply(&t, v3(0, 1, 0)), v3(2, 5, 8), 0.0);
    assert_close(m3_determinant(&a), -3.0, 1e-14);
    for (int i = 0; i < 100; i++) {
        mat3 b = random_matrix(), c = random_matrix(), product = m3_multiply(&b, &c), transposed = m3_transposed(&b);
        vec3 x = random_vector();
        assert_close_vector(m3_apply(&product, x), m3_apply(&b, m3_apply(&c, x)), 1e-14);
        assert_close_vector(m3_apply_transposed(&b, x), m3_apply(&transposed, x), 1e-15);
        assert_close(m3_determinant(&product), m3_determinant(&b) * m3_determinant(&c), 1e-13);
    }
}

static void inverse_times_matrix_is_one(void **state) {
    (void)state;
    for (int i = 0; i < 1000; i++) {
        mat3 a = random_matrix();
        if (fabs(m3_determinant(&a)) < 0.01) continue;
        mat3 inverse = m3_inverse(&a), left = m3_multiply(&inverse, &a), right = m3_multiply(&a, &inverse);
        assert_same_matrix(&left, &UNIT, 1e-12);
        assert_same_matrix(&right, &UNIT, 1e-12);
    }
}

static void quaternion_rotation_matches_rodrigues(void **state) {
    (void)state;
    assert_close_vector(q_rotate(q_exp(v3(0, 0, M_PI / 2)), v3(1, 0, 0)), v3(0, 1, 0), 1e-15);
    for (int i = 0; i < 1000; i++) {
        vec3 axis = v3_unit(random_vector()), x = random_vector();
        double angle = 4.0 * M_PI * uniform();
        mat3 expected = rodrigues(axis, angle), matrix = q_matrix(q_exp(v3_scale(angle, axis)));
        assert_same_matrix(&matrix, &expected, 1e-13);
        assert_close_vector(q_rotate(q_exp(v3_scale(angle, axis)), x), m3_apply(&expected, x), 1e-13);
    }
}

static void products_of_quaternions_are_products_of_matrices(void **state) {
    (void)state;
    for (int i = 0; i < 1000; i++) {
        quat p = q_unit((quat){uniform(), uniform(), uniform(), uniform()}), q = q_exp(random_vector());
        mat3 a = q_matrix(p), b = q_matrix(q), product = m3_multiply(&a, &b), matrix = q_matrix(q_multiply(p, q));
        assert_same_matrix(&matrix, &product, 1e-14);
        mat3 back = q_matrix(q_conjugate(p)), transposed = m3_transposed(&a);
        assert_same_matrix(&back, &transposed, 1e-15);
    }
}

/* Tests angles from 1e-12 rad to just below half a turn, where the logarithm is least accurate. */
static void logarithm_undoes_exponential(void **state) {
    (void)state;
    static const double angles[] = {0.0, 1e-12, 1e-9, 1e-8, 1e-5, 1e-4, 0.1, 1.0, 2.0, 3.0, 3.14, M_PI - 1e-7};
    for (size_t i = 0; i < sizeof angles / sizeof *angles; i++)
        for (int n = 0; n < 100; n++) {
            vec3 r = v3_scale(angles[i], v3_unit(random_vector()));
            quat q = q_exp(r), opposite = {-q.w, -q.x, -q.y, -q.z};
            assert_close_vector(q_log(q), r, 1e-15 + 1e-14 * angles[i]);
            assert_close_vector(q_log(opposite), r, 1e-15 + 1e-14 * angles[i]); /* the same rotation */
        }
    vec3 beyond = q_log(q_exp(v3(0, 0, 1.5 * M_PI))); /* three quarters of a turn are a quarter turn the other way */
    assert_close_vector(beyond, v3(0, 0, -0.5 * M_PI), 1e-14);
}

static vec3 lane_of(vec3_simd4 v, int i) { return v3(v.x[i], v.y[i], v.z[i]); }

static void assert_close_quat(quat a, quat b) {
    const double differences[] = {a.w - b.w, a.x - b.x, a.y - b.y, a.z - b.z};
    for (int i = 0; i < 4; i++) assert_true(fabs(differences[i]) < 1e-14);
}

/* Tests small and large angles in one set, with quaternions of either sign. */
static void four_at_once_are_as_one_by_one(void **state) {
    (void)state;
    for (int n = 0; n < 1000; n++) {
        vec3 a[SIMD4_WIDTH], b[SIMD4_WIDTH];
        quat p[SIMD4_WIDTH], q[SIMD4_WIDTH], exps[SIMD4_WIDTH], products[SIMD4_WIDTH], units[SIMD4_WIDTH];
        vec3_simd4 va, vb;
        for (int i = 0; i < SIMD4_WIDTH; i++) {
            a[i] = v3_scale(pow(10.0, 3.0 * uniform() - 3.0), random_vector());
            b[i] = random_vector();
            p[i] = q_unit((quat){uniform(), uniform(), uniform(), uniform()});
            q[i] = q_exp(a[i]);
            if (uniform() < 0.0) q[i] = (quat){-q[i].w, -q[i].x, -q[i].y, -q[i].z};
            va.x[i] = a[i].x, va.y[i] = a[i].y, va.z[i] = a[i].z;
            vb.x[i] = b[i].x, vb.y[i] = b[i].y, vb.z[i] = b[i].z;
        }
        ql_store(exps, ql_exp(va));
        ql_store(products, ql_multiply(ql_load(p), ql_conjugate(ql_load(q))));
        ql_store(units, ql_unit((quat_simd4){va.x, va.y, va.z, vb.x}));
        vec3_simd4 log = ql_log(ql_load(q)), cross = v3l_cross(va, vb), unit = v3l_unit(vb);
        vec3_simd4 axes[3] = {ql_axis_x(ql_load(p)), ql_axis_y(ql_load(p)), ql_axis(ql_load(p))};
        for (int i = 0; i < SIMD4_WIDTH; i++) {
            assert_close_quat(exps[i], q_exp(a[i]));
            assert_close_quat(products[i], q_multiply(p[i], q_conjugate(q[i])));
            assert_close_quat(units[i], q_unit((quat){a[i].x, a[i].y, a[i].z, b[i].x}));
            assert_close_vector(lane_of(log, i), q_log(q[i]), 1e-14);
            assert_close_vector(lane_of(cross, i), v3_cross(a[i], b[i]), 1e-14);
            assert_close_vector(lane_of(unit, i), v3_unit(b[i]), 1e-14);
            const vec3 expected[3] = {q_axis_x(p[i]), q_axis_y(p[i]), q_axis(p[i])};
            for (int k = 0; k < 3; k++) assert_close_vector(lane_of(axes[k], i), expected[k], 1e-14);
        }
    }
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(products_follow_the_right_hand),
        cmocka_unit_test(matrices_have_columns_and_rows),
        cmocka_unit_test(inverse_times_matrix_is_one),
        cmocka_unit_test(quaternion_rotation_matches_rodrigues),
        cmocka_unit_test(products_of_quaternions_are_products_of_matrices),
        cmocka_unit_test(logarithm_undoes_exponential),
        cmocka_unit_test(four_at_once_are_as_one_by_one),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
