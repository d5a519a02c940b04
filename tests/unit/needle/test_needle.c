/* Tests the needle: its limits and its centreline. */
#include "bending.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static void centreline_is_smooth(void **unused) {
    (void)unused;
    needle_model model = needle_made(20);
    needle_tangent *tangent = malloc(sizeof *tangent);
    needle_state state;
    needle_set_straight(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &state);
    bend(&model, &state, v3(0.1, 0.4, 0), tangent);
    needle_point before = needle_at(&model, &state, 0.0);
    assert_true(v3_norm(v3_sub(before.position, state.base.position)) < 1e-15);
    for (int i = 1; i <= 20000; i++) {
        needle_point p = needle_at(&model, &state, 0.2 * i / 20000);
        vec3 step = v3_sub(p.position, before.position);
        assert_true(fabs(v3_norm(step) / 1e-5 - 1.0) < 2e-3);
        assert_true(v3_norm(v3_sub(needle_along(&p), needle_along(&before))) < 1e-3);
        before = p;
    }
    assert_true(v3_norm(v3_sub(before.position, needle_tip_of(&model, &state))) < 1e-12);
    free(tangent);
}

/* Position and frame of a point on the needle move with the base. */
static void centreline_of_a_needle_at_rest_is_straight(void **unused) {
    (void)unused;
    pose base = {v3(0.3, -0.2, 0.1), q_exp(v3(0.7, -1.1, 2.0))};
    needle_model model = needle_made(20);
    needle_state state;
    needle_set_straight(&model, base, &state);
    for (double arc = 0.0; arc <= 0.2; arc += 0.003) {
        needle_point p = needle_at(&model, &state, arc);
        vec3 expected = v3_add(base.position, q_rotate(base.orientation, v3(0, 0, arc)));
        mat3 frame = q_matrix(base.orientation);
        assert_true(v3_norm(v3_sub(p.position, expected)) < 1e-15);
        for (int i = 0; i < 9; i++) assert_true(fabs(p.frame.m[i / 3][i % 3] - frame.m[i / 3][i % 3]) < 1e-12);
    }
}

static void bad_parameters_are_refused(void **unused) {
    (void)unused;
    needle_model model;
    trocar_error why;
    needle_parameters p = gauge18(1);
    assert_int_equal(needle_create(&p, &model, &why), TROCAR_BAD_INPUT);
    p = gauge18(40);
    p.inner_diameter = 2e-3;
    assert_int_equal(needle_create(&p, &model, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "inner_diameter"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(centreline_is_smooth),
        cmocka_unit_test(centreline_of_a_needle_at_rest_is_straight),
        cmocka_unit_test(bad_parameters_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
