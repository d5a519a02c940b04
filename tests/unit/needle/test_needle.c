/* Common to both needle models: selection, limits and centreline. */
#include "bending.h"
#include "needle/needle_kind.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static void check_centreline(needle_choice kind) {
    needle_model model = needle_made(kind, 20);
    needle_tangent *tangent = malloc(sizeof *tangent);
    needle_state state;
    needle_rest(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &state);
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

static void centreline_is_smooth(void **unused) {
    (void)unused;
    check_centreline(NEEDLE_ROD);
    check_centreline(NEEDLE_TETRAHEDRA);
}

/* Position and frame of a point move with the base in both models. */
static void centreline_of_a_needle_at_rest_is_straight(void **unused) {
    (void)unused;
    pose base = {v3(0.3, -0.2, 0.1), q_exp(v3(0.7, -1.1, 2.0))};
    for (int kind = NEEDLE_ROD; kind <= NEEDLE_TETRAHEDRA; kind++) {
        needle_model model = needle_made(kind, 20);
        needle_state state;
        needle_rest(&model, base, &state);
        for (double arc = 0.0; arc <= 0.2; arc += 0.003) {
            needle_point p = needle_at(&model, &state, arc);
            vec3 expected = v3_add(base.position, q_rotate(base.orientation, v3(0, 0, arc)));
            mat3 frame = q_matrix(base.orientation);
            assert_true(v3_norm(v3_sub(p.position, expected)) < 1e-15);
            for (int i = 0; i < 9; i++) assert_true(fabs(p.frame.m[i / 3][i % 3] - frame.m[i / 3][i % 3]) < 1e-12);
        }
    }
}

static void requested_model_is_created(void **unused) {
    (void)unused;
    needle_model rod = needle_made(NEEDLE_ROD, 20), tets = needle_made(NEEDLE_TETRAHEDRA, 20);
    assert_ptr_equal(rod.kind, &needle_kind_rod);
    assert_ptr_equal(tets.kind, &needle_kind_tetrahedra);
}

static void bad_parameters_are_refused(void **unused) {
    (void)unused;
    needle_model model;
    report why;
    needle_parameters p = gauge18(NEEDLE_ROD, 1);
    assert_int_equal(needle_create(&p, &model, &why), TROCAR_BAD_INPUT);
    p = gauge18(NEEDLE_ROD, 40);
    p.inner_diameter = 2e-3;
    assert_int_equal(needle_create(&p, &model, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "inner_diameter"));
    p = gauge18(NEEDLE_TETRAHEDRA, 40);
    p.poisson_ratio = 0.5;
    assert_int_equal(needle_create(&p, &model, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "poisson_ratio"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(centreline_is_smooth),
        cmocka_unit_test(centreline_of_a_needle_at_rest_is_straight),
        cmocka_unit_test(requested_model_is_created),
        cmocka_unit_test(bad_parameters_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
