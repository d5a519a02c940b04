/* Compares the rod with beam theory: small-deflection formulas, the elastica, Euler buckling and frame invariance. */
#include "bending.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static needle_model make(int segments) { return needle_made(segments); }

static vec3 tip(const needle_model *model, const needle_state *state) { return needle_tip_of(model, state); }

static void small_deflection_matches_a_cantilever(void **unused) {
    (void)unused;
    needle_model model = make(40);
    needle_state state;
    needle_tangent *tangent = malloc(sizeof *tangent);
    needle_set_straight(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &state);
    bend(&model, &state, v3(0, 1e-4, 0), tangent);
    double expected = 1e-4 * pow(0.2, 3) / (3.0 * model.bending);
    assert_true(fabs(tip(&model, &state).y / expected - 1.0) < 5e-4); /* the discretisation error is 1/(2 N^2) = 3e-4 */
    /* The tangent compliance gives the same deflection. */
    assert_true(fabs(tangent->compliance[3 * 40 + 1][3 * 40 + 1] / (pow(0.2, 3) / (3.0 * model.bending)) - 1.0) < 1e-3);
    /* The compliance between an inner joint and the tip is a^2 (3 L - a) / (6 EI). */
    double a = 0.1;
    assert_true(fabs(tangent->compliance[3 * 20 + 1][3 * 40 + 1] / (a * a * (0.6 - a) / (6.0 * model.bending)) - 1.0) < 1e-3);
    free(tangent);
}

static void large_deflection_follows_the_elastica(void **unused) {
    (void)unused;
    for (int c = 0; c < 3; c++) {
        double p = (double[]){0.5, 1.0, 2.0}[c], x, y; /* p = F L^2 / EI */
        elastica(p, &x, &y);
        needle_model model = make(64);
        needle_state state;
        needle_tangent *tangent = malloc(sizeof *tangent);
        needle_set_straight(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &state);
        bend(&model, &state, v3(0, p * model.bending / 0.04, 0), tangent);
        assert_true(fabs(tip(&model, &state).y / 0.2 - y) < 5e-4);
        assert_true(fabs(tip(&model, &state).z / 0.2 - x) < 5e-4);
        free(tangent);
    }
}

/* Under an axial load below Euler's load, pi^2 EI / (4 L^2), the lateral compliance is tan(kL)/(k P) - L/P. */
static void axial_load_softens_like_a_beam_column(void **unused) {
    (void)unused;
    needle_model model = make(60);
    needle_state state;
    needle_tangent *tangent = malloc(sizeof *tangent);
    vec3 load[NEEDLE_MAX_SEGMENTS + 1];
    memset(load, 0, sizeof load);
    needle_set_straight(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &state);
    double euler = M_PI * M_PI * model.bending / (4 * 0.04);
    for (int c = 0; c < 3; c++) {
        double compression = (double[]){0.3, 0.8, 2.0}[c] * euler; /* the last load is beyond buckling, so the compliance is negative */
        load[60] = v3(0, 0, -compression);
        needle_linearise(&model, &state, load, 0, tangent);
        double k = sqrt(compression / model.bending), expected = tan(k * 0.2) / (k * compression) - 0.2 / compression;
        assert_true(fabs(tangent->compliance[181][181] / expected - 1.0) < 5e-3);
    }
    free(tangent);
}

/* For a bent and compressed needle, computing the compliance from the first joint on gives the same as for the whole needle. */
static void compliance_does_not_depend_on_the_first_joint(void **unused) {
    (void)unused;
    needle_model model = make(40);
    needle_state state;
    needle_tangent *whole = calloc(1, sizeof *whole), *part = calloc(1, sizeof *part);
    vec3 load[NEEDLE_MAX_SEGMENTS + 1];
    memset(load, 0, sizeof load);
    needle_set_straight(&model, (pose){v3(0, 0, 0), q_exp(v3(0.3, -0.4, 0.5))}, &state);
    load[40] = v3(0.1, 0.25, -0.1);
    load[22] = v3(-0.2, 0.2, 0.3);
    for (int i = 0; i < 4; i++) {
        needle_linearise(&model, &state, load, 0, whole);
        needle_advance(&model, whole, load, &state);
    }
    needle_linearise(&model, &state, load, 0, whole);
    double largest = fabs(whole->compliance[3 * 40][3 * 40]);
    for (int first = 1; first <= 39; first++) {
        needle_linearise(&model, &state, load, first, part);
        for (int i = 3 * first; i < 3 * 41; i++)
            for (int j = 3 * (i / 3 - 2 > first ? i / 3 - 2 : first); j < 3 * 41; j++) /* compares the upper triangle and two joints below the diagonal */
                assert_true(fabs(part->compliance[i][j] - whole->compliance[i][j]) < 1e-12 * largest);
    }
    free(whole);
    free(part);
}

/* Segments are computed in groups of four, and most of these segment counts leave a remainder. The tip's compliance equals the derivative of its equilibrium
   position. */
static void any_number_of_segments_will_do(void **unused) {
    (void)unused;
    static const int numbers[] = {2, 3, 5, 6, 7, 9, 38, 63, 64};
    for (int i = 0; i < 9; i++) {
        needle_model model = make(numbers[i]);
        needle_tangent *tangent = malloc(sizeof *tangent);
        vec3 force = v3(1e-3, 2e-3, -1e-3), moved[3]; /* small, because the tangent omits third powers of the angles between segments */
        double step = 1e-4, most = 0.0;
        for (int a = 0; a < 3; a++) {
            vec3 ends[2];
            for (int side = 0; side < 2; side++) {
                needle_state state;
                needle_set_straight(&model, (pose){v3(0, 0, 0), q_exp(v3(0.3, -0.4, 0.5))}, &state);
                double d = side ? step : -step;
                bend(&model, &state, v3_add(force, v3(a == 0 ? d : 0, a == 1 ? d : 0, a == 2 ? d : 0)), tangent);
                ends[side] = tip(&model, &state);
            }
            moved[a] = v3_scale(0.5 / step, v3_sub(ends[1], ends[0]));
            most = fmax(most, v3_norm(moved[a]));
        }
        needle_state state;
        needle_set_straight(&model, (pose){v3(0, 0, 0), q_exp(v3(0.3, -0.4, 0.5))}, &state);
        bend(&model, &state, force, tangent);
        for (int a = 0; a < 3; a++) {
            const double expected[] = {moved[a].x, moved[a].y, moved[a].z};
            for (int b = 0; b < 3; b++) assert_true(fabs(tangent->compliance[3 * numbers[i] + b][3 * numbers[i] + a] - expected[b]) < 1e-6 * most);
        }
        free(tangent);
    }
}

/* A needle with a free tip buckles in both lateral directions at every load of (2 n - 1)^2 times Euler's load. */
static void buckling_modes_match_euler(void **unused) {
    (void)unused;
    needle_model model = make(60);
    needle_state state;
    needle_tangent *tangent = malloc(sizeof *tangent);
    vec3 load[NEEDLE_MAX_SEGMENTS + 1];
    memset(load, 0, sizeof load);
    needle_set_straight(&model, (pose){v3(0, 0, 0), q_exp(v3(0.3, -0.2, 0.5))}, &state);
    double euler = M_PI * M_PI * model.bending / (4 * 0.04), beside[] = {-5.0, 0.98, 1.02, 8.8, 9.2, 24.5, 25.5};
    const int ways[] = {0, 0, 2, 2, 4, 4, 6};
    for (int c = 0; c < 7; c++) {
        load[60] = q_rotate(state.base.orientation, v3(0, 0, -beside[c] * euler));
        needle_linearise(&model, &state, load, 0, tangent);
        assert_int_equal(tangent->unstable, ways[c]);
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
    needle_set_straight(&model, (pose){v3(0, 0, 0), q_exp(v3(0.3, -0.4, 0.5))}, &state);
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

static void rotated_base_gives_rotated_shape(void **unused) {
    (void)unused;
    needle_model model = make(40);
    needle_tangent *tangent = malloc(sizeof *tangent);
    needle_state plain, turned;
    quat q = q_exp(v3(0.7, -1.1, 2.0));
    vec3 shift = v3(0.3, -0.2, 0.1), force = v3(0.1, 0.3, -0.4);
    needle_set_straight(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &plain);
    needle_set_straight(&model, (pose){shift, q}, &turned);
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
    needle_set_straight(&model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, &state);
    needle_move_base(&model, (pose){v3(0, 0, 0), q_exp(v3(0, 0, 0.8))}, &state);
    for (int i = 0; i < 4; i++) {
        needle_linearise(&model, &state, load, 0, tangent);
        needle_advance(&model, tangent, load, &state);
    }
    vec3 y = q_rotate(state.frames[39], v3(0, 1, 0));
    assert_true(fabs(y.x + sin(0.8)) < 1e-12 && fabs(y.y - cos(0.8)) < 1e-12);
    assert_true(needle_energy(&model, &state) < 1e-20);
    free(tangent);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(small_deflection_matches_a_cantilever), cmocka_unit_test(large_deflection_follows_the_elastica),
        cmocka_unit_test(compliance_does_not_depend_on_the_first_joint),
        cmocka_unit_test(any_number_of_segments_will_do),
        cmocka_unit_test(buckling_modes_match_euler),
        cmocka_unit_test(axial_load_softens_like_a_beam_column),      cmocka_unit_test(newton_converges_quadratically),
        cmocka_unit_test(rotated_base_gives_rotated_shape),           cmocka_unit_test(roll_of_the_base_reaches_the_tip),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
