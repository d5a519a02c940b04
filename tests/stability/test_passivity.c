/* Tests the passivity observer and controller with energies known in closed form. */
#include <math.h>

#include "passivity.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static const double PERIOD = 1e-4, STIFFNESS = 400.0, AMPLITUDE = 2e-3, FREQUENCY = 10.0;

/* A device moves as A sin(w t), its position is read `delay` periods later, and a spring K responds to each position. Returns the energy (J) observed in
   `cycles` by an observer that assumes `known` periods from a command to the reading it affects. */
static double observed(int delay, int known, int cycles) {
    passivity p = {.period = PERIOD, .delay = known, .max_force = 20};
    double w = 2 * M_PI * FREQUENCY, begin = 0;
    int cycle = (int)lround(1.0 / (FREQUENCY * PERIOD));
    for (int i = 0; i <= (cycles + 1) * cycle; i++) {
        double x = AMPLITUDE * sin(w * PERIOD * (i - delay));
        passivity_next(&p, v3(x, 0, 0), v3(-STIFFNESS * x, 0, 0));
        if (i == cycle) begin = p.energy;
    }
    return p.energy - begin;
}

/* A spring K with a delay T does the work pi K A^2 sin(w T) per cycle on a motion A sin(w t). T is `delay` periods minus half a period, because the midpoint
   of a motion interval lies half a period before its end, when the position is read. */
static void a_delayed_spring_makes_this_energy(void **unused) {
    (void)unused;
    for (int delay = 1; delay <= 60; delay += 7) {
        double late = PERIOD * (delay - 0.5), expected = M_PI * STIFFNESS * AMPLITUDE * AMPLITUDE * sin(2 * M_PI * FREQUENCY * late);
        assert_true(fabs(observed(0, delay, 5) - 5 * expected) < 1e-3 * 5 * M_PI * STIFFNESS * AMPLITUDE * AMPLITUDE);
    }
}

/* The observed energy depends on the delay the observer assumes, not on the device's, because the observer sees only commands and readings, which could come
   from any device. */
static void an_unknown_delay_is_not_seen(void **unused) {
    (void)unused;
    for (int delay = 0; delay <= 50; delay += 10) assert_true(fabs(observed(delay, 1, 5) - observed(0, 1, 5)) < 1e-9);
    assert_true(observed(20, 41, 5) > 100 * fabs(observed(20, 1, 5)) / 5);
}

static void a_passive_force_passes_unchanged(void **unused) {
    (void)unused;
    passivity p = {.period = 1e-3, .delay = 1, .most_damping = 5, .max_force = 20};
    double x = 0, v = 0.1;
    for (int i = 0; i < 2000; i++) { /* a hand pushes into a damper */
        x += 1e-3 * v;
        vec3 force = passivity_next(&p, v3(x, 0, 0), v3(-3.0, 0, 0));
        assert_true(force.x == -3.0);
    }
    assert_true(p.most <= 0.0);
}

/* The force drives the device, and the controller brakes it with no more than the maximum damping. */
static void energy_is_dissipated_within_the_bound(void **unused) {
    (void)unused;
    passivity p = {.period = 1e-3, .delay = 1, .most_damping = passivity_damping(0.1, 3e-3), .max_force = 20};
    assert_true(fabs(p.most_damping - 10.0) < 1e-12);
    double x = 0, least = INFINITY;
    for (int i = 0; i < 500; i++) {
        x += 1e-4;
        vec3 force = passivity_next(&p, v3(x, 0, 0), v3(0.5, 0, 0));
        least = fmin(least, force.x);
        assert_true(force.x <= 0.5 && force.x >= 0.5 - p.most_damping * 0.1 - 1e-9);
    }
    assert_true(least < 0.0); /* the damping force, 10 N s/m at 0.1 m/s, exceeds the driving force of 0.5 N */
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_delayed_spring_makes_this_energy),
        cmocka_unit_test(an_unknown_delay_is_not_seen),
        cmocka_unit_test(a_passive_force_passes_unchanged),
        cmocka_unit_test(energy_is_dissipated_within_the_bound),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
