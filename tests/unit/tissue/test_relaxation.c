/* Compares the creep computed from the relaxation with a numerical solution of the convolution integral that relates the two. */
#include "tissue/relaxation.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

static const relaxation_term FORCE_AFTER_SECONDS[] = {{0.25, 0.15}, {0.15, 2.5}, {0.10, 30.0}};

static double creep_at(const creep_series *creep, double t) {
    double sum = 1.0;
    for (int k = 0; k < creep->count; k++) sum -= creep->compliance[k] * expm1(-t / creep->time[k]);
    return sum;
}

/* Solves integral of G(t - s) dJ(s) = 1 for a constant unit force. J changes in steps, each at the midpoint of its interval. */
static double *creep_by_quadrature(int count, const relaxation_term *terms, double step, int steps) {
    double *j = calloc((size_t)steps + 1, sizeof *j);
    j[0] = 1.0;
    for (int n = 1; n <= steps; n++) {
        double sum = relaxation_at(count, terms, n * step);
        for (int i = 1; i < n; i++) sum += (j[i] - j[i - 1]) * relaxation_at(count, terms, (n - i + 0.5) * step);
        j[n] = j[n - 1] + (1.0 - sum) / relaxation_at(count, terms, 0.5 * step);
    }
    return j;
}

static void check_against_quadrature(int count, const relaxation_term *terms, double step, int steps, double tolerance) {
    creep_series creep;
    trocar_error why;
    assert_int_equal(creep_from_relaxation(count, terms, &creep, &why), TROCAR_OK);
    double *expected = creep_by_quadrature(count, terms, step, steps);
    for (int n = 1; n <= steps; n++) {
        double error = fabs(creep_at(&creep, n * step) / expected[n] - 1.0);
        if (error > tolerance) fail_msg("creep after %g s: %.9g, expected %.9g", n * step, creep_at(&creep, n * step), expected[n]);
    }
    free(expected);
}

static void creep_and_relaxation_belong_together(void **unused) {
    (void)unused;
    static const relaxation_term one[] = {{0.5, 1.0}}, almost_all[] = {{0.6, 0.02}, {0.39, 0.5}}, close[] = {{0.2, 1.0}, {0.2, 1.001}, {0.2, 0.3}, {0.1, 10.0}};
    check_against_quadrature(1, one, 2e-3, 2000, 1e-6);
    check_against_quadrature(3, FORCE_AFTER_SECONDS, 2e-3, 3000, 3e-6);
    check_against_quadrature(2, almost_all, 2e-4, 3000, 3e-6);
    check_against_quadrature(4, close, 2e-3, 3000, 3e-6);
}

/* The long-term displacement under a constant force, relative to the initial one, is the reciprocal of the fraction of stress that remains under constant
   strain. */
static void long_term_values_are_inverse(void **unused) {
    (void)unused;
    creep_series creep;
    trocar_error why;
    creep_from_relaxation(3, FORCE_AFTER_SECONDS, &creep, &why);
    double sum = 1.0;
    for (int k = 0; k < 3; k++) sum += creep.compliance[k];
    assert_true(fabs(sum - 1.0 / 0.5) < 1e-12);
    assert_true(creep.time[0] < creep.time[1] && creep.time[1] < creep.time[2]);
    creep_from_relaxation(0, NULL, &creep, &why);
    assert_int_equal(creep.count, 0);
}

static void impossible_series_are_refused(void **unused) {
    (void)unused;
    static const struct { int count; relaxation_term terms[2]; const char *words; } cases[] = {
        {1, {{0.0, 1.0}}, "relaxation[0].weight: not above 0"},
        {1, {{-0.1, 1.0}}, "relaxation[0].weight: not above 0"},
        {1, {{NAN, 1.0}}, "relaxation[0].weight: not above 0"},
        {1, {{1.0, 1.0}}, "relaxation[0].weight: the weights up to here add up to 1 or more"},
        {2, {{0.5, 1.0}, {0.5, 2.0}}, "relaxation[1].weight: the weights up to here add up to 1 or more"},
        {1, {{0.5, 0.0}}, "relaxation[0].time: not a time above 0"},
        {1, {{0.5, -2.0}}, "relaxation[0].time: not a time above 0"},
        {1, {{0.5, INFINITY}}, "relaxation[0].time: not a time above 0"},
        {2, {{0.2, 1.0}, {0.3, 1.0}}, "relaxation[1].time: the same as that of an earlier term"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        creep_series creep;
        trocar_error why;
        assert_int_equal(creep_from_relaxation(cases[i].count, cases[i].terms, &creep, &why), TROCAR_BAD_INPUT);
        if (strncmp(why.text, cases[i].words, strlen(cases[i].words)) != 0) fail_msg("\"%s\" where \"%s\" was expected", why.text, cases[i].words);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(creep_and_relaxation_belong_together),
        cmocka_unit_test(long_term_values_are_inverse),
        cmocka_unit_test(impossible_series_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
