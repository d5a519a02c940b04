/* The rod against beam theory: small-deflection formulas, the elastica, Euler buckling, frame invariance. */
#include "needle.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>


static needle_parameters gauge18(int segments) {
    return (needle_parameters){.length = 0.2, .outer_diameter = 1.27e-3, .inner_diameter = 0.84e-3, .youngs_modulus = 200e9,
                               .poisson_ratio = 0.3, .segments = segments};
}

static needle_model make(int segments) {
    needle_parameters p = gauge18(segments);
    needle_model model;
    report why;
    assert_int_equal(needle_create(&p, &model, &why), TROCAR_OK);
    return model;
}

/* Newton to equilibrium under a constant force on the tip, in steps of the load. */
static void bend(const needle_model *model, needle_state *state, vec3 tip_force, needle_tangent *tangent) {
    vec3 load[NEEDLE_MAX_SEGMENTS + 1];
    memset(load, 0, sizeof load);
    for (int step = 1; step <= 20; step++) {
        load[model->given.segments] = v3_scale(step / 20.0, tip_force);
        for (int pass = 0; pass < 50; pass++) {
            needle_linearise(model, state, load, 0, tangent);
            if (needle_advance(model, tangent, load, state) < 1e-13) break;
        }
    }
}

static vec3 tip(const needle_model *model, const needle_state *state) { return state->joints[model->given.segments]; }

static void small_deflection_is_that_of_a_cantilever(void **unused) {
    (void)unused;
    needle_model model = make(40);
    needle_state state;
    needle_tangent *tangent = malloc(sizeof *tangent);
    needle_rest(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &state);
    bend(&model, &state, v3(0, 1e-4, 0), tangent);
    double expected = 1e-4 * pow(0.2, 3) / (3.0 * model.bending);
    assert_true(fabs(tip(&model, &state).y / expected - 1.0) < 5e-4); /* 1/(2 N^2) = 3e-4 */
    /* the tangent's own compliance is the same number */
    assert_true(fabs(tangent->compliance[3 * 40 + 1][3 * 40 + 1] / (pow(0.2, 3) / (3.0 * model.bending)) - 1.0) < 1e-3);
    /* compliance between an inner joint and the tip: a^2 (3 L - a) / (6 EI) */
    double a = 0.1;
    assert_true(fabs(tangent->compliance[3 * 20 + 1][3 * 40 + 1] / (a * a * (0.6 - a) / (6.0 * model.bending)) - 1.0) < 1e-3);
    free(tangent);
}

/* Cantilever with a dead tip load: the elastica by fine integration and shooting, independent of the rod's code. */
static double elastica_angle(double base_slope_rate, double p, double *x, double *y) {
    int n = 20000;
    double theta = 0.0, kappa = base_slope_rate, ds = 1.0 / n;
    *x = *y = 0.0;
    for (int i = 0; i < n; i++) { /* theta'' = -p cos(theta), midpoint rule */
        double tm = theta + 0.5 * ds * kappa, km = kappa - 0.5 * ds * p * cos(theta);
        *x += ds * cos(tm);
        *y += ds * sin(tm);
        theta += ds * km;
        kappa -= ds * p * cos(tm);
    }
    return kappa; /* curvature at the tip: must vanish */
}

static void large_deflection_follows_the_elastica(void **unused) {
    (void)unused;
    for (int c = 0; c < 3; c++) {
        double p = (double[]){0.5, 1.0, 2.0}[c], low = 0.0, high = 10.0, x, y; /* p = F L^2 / EI */
        for (int i = 0; i < 100; i++) {
            double middle = 0.5 * (low + high);
            if (elastica_angle(middle, p, &x, &y) < 0) low = middle; else high = middle;
        }
        needle_model model = make(64);
        needle_state state;
        needle_tangent *tangent = malloc(sizeof *tangent);
        needle_rest(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &state);
        bend(&model, &state, v3(0, p * model.bending / 0.04, 0), tangent);
        assert_true(fabs(tip(&model, &state).y / 0.2 - y) < 5e-4);
        assert_true(fabs(tip(&model, &state).z / 0.2 - x) < 5e-4);
        free(tangent);
    }
}

/* Under an axial load below Euler's pi^2 EI / (4 L^2) the sideways compliance is tan(kL)/(k P) - L/P. */
static void axial_load_softens_as_a_beam_column(void **unused) {
    (void)unused;
    needle_model model = make(60);
    needle_state state;
    needle_tangent *tangent = malloc(sizeof *tangent);
    vec3 load[NEEDLE_MAX_SEGMENTS + 1];
    memset(load, 0, sizeof load);
    needle_rest(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &state);
    double euler = M_PI * M_PI * model.bending / (4 * 0.04);
    for (int c = 0; c < 3; c++) {
        double compression = (double[]){0.3, 0.8, 2.0}[c] * euler; /* the last one is buckled: negative compliance */
        load[60] = v3(0, 0, -compression);
        needle_linearise(&model, &state, load, 0, tangent);
        double k = sqrt(compression / model.bending), expected = tan(k * 0.2) / (k * compression) - 0.2 / compression;
        assert_true(fabs(tangent->compliance[181][181] / expected - 1.0) < 5e-3);
    }
    free(tangent);
}

static void newton_converges_quadratically(void **unused) {
    (void)unused;
    needle_model model = make(40);
    needle_state state;
    needle_tangent *tangent = malloc(sizeof *tangent);
    vec3 load[NEEDLE_MAX_SEGMENTS + 1];
    memset(load, 0, sizeof load);
    needle_rest(&model, (pose){v3(0, 0, 0), q_exp(v3(0.3, -0.4, 0.5))}, &state);
    load[40] = v3(0.1, 0.25, -0.1);
    load[22] = v3(-0.2, 0.2, 0.3);
    double change[8];
    for (int i = 0; i < 8; i++) {
        needle_linearise(&model, &state, load, 0, tangent);
        change[i] = needle_advance(&model, tangent, load, &state);
    }
    assert_true(change[7] < 1e-12);
    assert_true(change[5] < 1e-6);
    free(tangent);
}

static void turned_base_gives_turned_shape(void **unused) {
    (void)unused;
    needle_model model = make(40);
    needle_tangent *tangent = malloc(sizeof *tangent);
    needle_state plain, turned;
    quat q = q_exp(v3(0.7, -1.1, 2.0));
    vec3 shift = v3(0.3, -0.2, 0.1), force = v3(0.1, 0.3, -0.4);
    needle_rest(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &plain);
    needle_rest(&model, (pose){shift, q}, &turned);
    bend(&model, &plain, force, tangent);
    bend(&model, &turned, q_rotate(q, force), tangent);
    for (int k = 0; k <= 40; k++) {
        vec3 expected = v3_add(shift, q_rotate(q, plain.joints[k]));
        assert_true(v3_norm(v3_sub(turned.joints[k], expected)) < 1e-10);
    }
    assert_true(fabs(needle_energy(&model, &plain) / needle_energy(&model, &turned) - 1.0) < 1e-9);
    free(tangent);
}

static void roll_of_the_base_reaches_the_tip(void **unused) {
    (void)unused;
    needle_model model = make(40);
    needle_tangent *tangent = malloc(sizeof *tangent);
    needle_state state;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1];
    memset(load, 0, sizeof load);
    needle_rest(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &state);
    needle_hold(&model, (pose){v3(0, 0, 0), q_exp(v3(0, 0, 0.8))}, &state);
    for (int i = 0; i < 4; i++) {
        needle_linearise(&model, &state, load, 0, tangent);
        needle_advance(&model, tangent, load, &state);
    }
    vec3 y = q_rotate(state.frames[39], v3(0, 1, 0));
    assert_true(fabs(y.x + sin(0.8)) < 1e-12 && fabs(y.y - cos(0.8)) < 1e-12);
    assert_true(needle_energy(&model, &state) < 1e-20);
    free(tangent);
}

static void centreline_is_smooth(void **unused) {
    (void)unused;
    needle_model model = make(20);
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
        vec3 t = v3(p.frame.m[0][2], p.frame.m[1][2], p.frame.m[2][2]), t0 = v3(before.frame.m[0][2], before.frame.m[1][2], before.frame.m[2][2]);
        assert_true(v3_norm(v3_sub(t, t0)) < 1e-3);
        before = p;
    }
    assert_true(v3_norm(v3_sub(before.position, tip(&model, &state))) < 1e-12);
    free(tangent);
}

static void bad_parameters_are_refused(void **unused) {
    (void)unused;
    needle_model model;
    report why;
    needle_parameters p = gauge18(1);
    assert_int_equal(needle_create(&p, &model, &why), TROCAR_BAD_INPUT);
    p = gauge18(40);
    p.inner_diameter = 2e-3;
    assert_int_equal(needle_create(&p, &model, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "inner_diameter"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(small_deflection_is_that_of_a_cantilever), cmocka_unit_test(large_deflection_follows_the_elastica),
        cmocka_unit_test(axial_load_softens_as_a_beam_column),      cmocka_unit_test(newton_converges_quadratically),
        cmocka_unit_test(turned_base_gives_turned_shape),           cmocka_unit_test(roll_of_the_base_reaches_the_tip),
        cmocka_unit_test(centreline_is_smooth),                     cmocka_unit_test(bad_parameters_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
