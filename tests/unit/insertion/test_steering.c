/* Tests bevel-tip steering: its direction, its curvature, and how they depend on the parameters. */
#include "steering.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static const double FROM = 0.03, TO = 0.08; /* m, depths over which the track's curvature is fitted */

static double curvature_of(const steering_case *c) {
    steering_track track = steering_run(c);
    double curvature = steering_curvature(&track, FROM, TO, steering_direction(c->roll));
    print_message("slope %g, needle %g GPa, tissue %g kPa, roll %g deg: curvature %.3f 1/m\n", c->needle.bevel_slope,
                  c->needle.youngs_modulus * 1e-9, c->tissue_modulus * 1e-3, c->roll * 180 / M_PI, curvature);
    return curvature;
}

/* Tests the curvature fit itself, on a circle of known radius. */
static void curvature_of_an_arc_is_recovered(void **unused) {
    (void)unused;
    steering_track arc = {.count = 30};
    for (int i = 0; i < arc.count; i++) {
        double angle = 0.4 * i / (arc.count - 1);
        arc.points[i] = v3(0.01, -0.2 * (1.0 - cos(angle)), 0.2 * sin(angle));
    }
    assert_true(fabs(steering_curvature(&arc, 0, 1, v3(0, -1, 0)) - 5.0) < 0.05);
    assert_true(fabs(steering_curvature(&arc, 0, 1, v3(0, 1, 0)) + 5.0) < 0.05);
}

static void needle_without_bevel_goes_straight(void **unused) {
    (void)unused;
    steering_case steel = steering_steel(0.0), nitinol = steering_nitinol(0.0);
    steering_track stiff = steering_run(&steel), thin = steering_run(&nitinol);
    print_message("deflection: steel %.3f %.3f mm, nitinol %.3f %.3f mm\n", 1e3 * steering_deflection(&stiff, v3(1, 0, 0)),
                  1e3 * steering_deflection(&stiff, v3(0, 1, 0)), 1e3 * steering_deflection(&thin, v3(1, 0, 0)), 1e3 * steering_deflection(&thin, v3(0, 1, 0)));
    assert_true(fabs(steering_deflection(&stiff, v3(1, 0, 0))) < 1e-4);
    assert_true(fabs(steering_deflection(&stiff, v3(0, 1, 0))) < 1e-4);
    assert_true(fabs(steering_deflection(&thin, v3(1, 0, 0))) < 5e-4); /* not zero: a coarse mesh deflects a thin needle (see verify_steering) */
    assert_true(fabs(steering_deflection(&thin, v3(0, 1, 0))) < 5e-4);
}

/* A bevel facing +y steers toward -y. Rolling the base rotates the track with it, though not exactly, because the mesh is not symmetric. */
static void path_bends_away_from_the_bevels_face(void **unused) {
    (void)unused;
    double upright = 0.0;
    for (int quarter = 0; quarter < 4; quarter++) {
        steering_case c = steering_steel(0.1);
        c.x = c.y = 0.0;
        c.roll = quarter * M_PI / 2;
        steering_track track = steering_run(&c);
        vec3 toward = steering_direction(c.roll), across = v3_cross(toward, v3(0, 0, 1));
        double deflection = steering_deflection(&track, toward), off = steering_deflection(&track, across);
        print_message("roll %3d deg: deflection %.2f mm, across %.2f mm\n", 90 * quarter, 1e3 * deflection, 1e3 * off);
        if (quarter == 0) upright = deflection;
        assert_true(steering_curvature(&track, FROM, TO, toward) > 0.5);
        assert_true(deflection > 5e-3 && fabs(deflection / upright - 1.0) < 0.07);
        assert_true(fabs(off) < 0.05 * deflection);
    }
}

/* After half a turn, a thin needle curves the other way at once. A stiff needle, whose bending decays over about 35 mm, ends up where superposition
   predicts. */
static void half_turn_gives_an_s_shaped_track(void **unused) {
    (void)unused;
    steering_case cases[] = {steering_steel(0.1), steering_nitinol(0.05)};
    for (int i = 0; i < 2; i++) {
        steering_case c = cases[i], never = c;
        c.half_turn_at = 0.04;
        steering_track s = steering_run(&c), arc = steering_run(&never);
        vec3 toward = steering_direction(0.0);
        double first = steering_curvature(&s, 0.0, 0.034, toward), second = steering_curvature(&s, 0.042, 0.08, toward);
        double end = steering_deflection(&s, toward), without = steering_deflection(&arc, toward), superposed = steering_superposed(&c, 0.04, toward);
        print_message("half turn: curvature %.3f, then %.3f 1/m; ends at %.2f mm, superposed %.2f mm, without %.2f mm\n", first, second, 1e3 * end,
                      1e3 * superposed, 1e3 * without);
        assert_true(i == 0 || (first > 0.5 && second < -0.5));
        assert_true(fabs(end - superposed) < 0.05 * without);
        assert_true(fabs(end) < 0.5 * without);
    }
}

static void curvature_increases_with_the_bevel_slope(void **unused) {
    (void)unused;
    double last = 0.0;
    for (double slope = 0.025; slope < 0.11; slope *= 2) {
        steering_case c = steering_steel(slope);
        double curvature = curvature_of(&c);
        assert_true(curvature > 1.5 * last);
        last = curvature;
    }
}

static void curvature_depends_on_needle_and_tissue_stiffness(void **unused) {
    (void)unused;
    double last = INFINITY;
    for (double modulus = 50e9; modulus < 900e9; modulus *= 4) {
        steering_case c = steering_steel(0.05);
        c.needle.youngs_modulus = modulus;
        double curvature = curvature_of(&c);
        assert_true(curvature > 0.0 && curvature < 0.8 * last);
        last = curvature;
    }
    last = 0.0;
    for (double modulus = 25e3; modulus < 110e3; modulus *= 2) {
        steering_case c = steering_steel(0.05);
        c.tissue_modulus = modulus;
        double curvature = curvature_of(&c);
        assert_true(curvature > 1.1 * last);
        last = curvature;
    }
}

/* Webster et al. 2006 report a radius of curvature of about 0.22 m for a 0.7 mm nitinol wire in stiff gel. The bevel slope here is 0.05. */
static void thin_nitinol_matches_webster(void **unused) {
    (void)unused;
    steering_case c = steering_nitinol(0.05);
    double radius = 1.0 / curvature_of(&c);
    assert_true(radius > 0.15 && radius < 0.33);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(curvature_of_an_arc_is_recovered),
        cmocka_unit_test(needle_without_bevel_goes_straight),
        cmocka_unit_test(path_bends_away_from_the_bevels_face),
        cmocka_unit_test(half_turn_gives_an_s_shaped_track),
        cmocka_unit_test(curvature_increases_with_the_bevel_slope),
        cmocka_unit_test(curvature_depends_on_needle_and_tissue_stiffness),
        cmocka_unit_test(thin_nitinol_matches_webster),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
