/* Compares the stability margins of the hand-device-coupling loop with closed forms, and theory with simulation. */
#include <math.h>

#include "device/loop_margin.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#define EACH(x, list) for (const double *x = (list); x < (list) + sizeof(list) / sizeof *(list); x++)

static const double PERIOD = 1e-3;

static haptic_loop loop_of(double stiffness, double damping, int delay) {
    return (haptic_loop){.mass = 0.1, .damping = 2, .stiffness = 500, .coupling_stiffness = stiffness, .coupling_damping = damping, .period = PERIOD,
                         .delay = delay};
}

/* The condition of Colgate and Schenkel for a wall without delay: b > K T / 2 + B. */
static void without_delay_half_a_period_of_the_spring_and_the_damper(void **unused) {
    (void)unused;
    static const double stiffnesses[] = {10, 400, 5000}, dampings[] = {0, 0.3, 20};
    double frequency;
    EACH(k, stiffnesses) EACH(b, dampings) {
        haptic_loop l = loop_of(*k, *b, 0);
        assert_true(fabs(loop_required_damping(&l, &frequency) - (0.5 * *k * PERIOD + *b)) < 1e-9 * *k);
        if (*b > 0) assert_true(fabs(frequency - 0.5 / PERIOD) < 1e-9); /* with a damper, the highest frequency needs the most damping */
    }
}

/* A spring with a delay of d periods needs b > K T (d + 1/2), the limit for slow motions. The scan starts above zero frequency, hence the tolerance. */
static void a_delayed_spring_needs_damping_for_the_delay(void **unused) {
    (void)unused;
    double frequency;
    for (int delay = 1; delay < 50; delay += 7) {
        haptic_loop l = loop_of(400, 0, delay);
        double expected = 400 * PERIOD * (delay + 0.5);
        assert_true(fabs(loop_required_damping(&l, &frequency) / expected - 1) < 1e-3);
        assert_true(frequency < 0.01 / PERIOD);
    }
}

/* If the oscillation is slow compared with sampling, the loop is m s^2 + (b + B) s + k + K with a small delay in the force. For a pure spring and a heavy
   hand, the gain margin against a delay of half a period alone follows from g K T / 2 = b. */
static void a_slow_hand_oscillates_when_the_delay_eats_its_damping(void **unused) {
    (void)unused;
    double frequency;
    for (int delay = 0; delay < 6; delay++) {
        haptic_loop l = loop_of(1, 0, delay);
        l.mass = 100;
        l.damping = 0.1;
        l.stiffness = 10;
        double critical = l.damping / (PERIOD * (delay + 0.5)); /* N/m; so soft that the oscillation is slow */
        assert_true(fabs(loop_gain_margin(&l, &frequency) / critical - 1) < 1e-2);
        assert_true(fabs(frequency - sqrt((10 + critical) / 100) / (2 * M_PI)) < 1e-2 * frequency);
    }
}

static void theory_and_simulation_agree(void **unused) {
    (void)unused;
    static const double masses[] = {0.05, 0.3, 2}, dampings[] = {0, 0.5, 5}, stiffnesses[] = {100, 2000};
    double frequency;
    EACH(mass, masses) EACH(damping, dampings) EACH(stiffness, stiffnesses) for (int delay = 0; delay <= 16; delay += 4) {
        haptic_loop l = loop_of(*stiffness, 2 * *stiffness * PERIOD * (delay + 1), delay);
        l.mass = *mass;
        l.damping = *damping;
        double theory = loop_gain_margin(&l, &frequency), simulated = loop_simulated_margin(&l);
        if (*damping == 0 && theory < 1e-3 && simulated < 1e-3) continue; /* without damping, any coupling that lags makes the loop oscillate */
        if (fabs(simulated / theory - 1) > 0.02)
            fail_msg("%g kg, %g N s/m, %g N/m, %d periods: %g in theory, %g in simulation", *mass, *damping, *stiffness, delay, theory, simulated);
    }
}

static void a_push_rests_only_in_a_stable_loop(void **unused) {
    (void)unused;
    const loop_limits limits = {.max_force = 20, .max_force_rate = 1e5, .resolution = 1e-6};
    double frequency;
    haptic_loop l = loop_of(400, 3.2, 3);
    double margin = loop_gain_margin(&l, &frequency);
    for (int i = 0; i < 2; i++) {
        haptic_loop scaled = l;
        double factor = margin * (i ? 1.3 : 0.5);
        scaled.coupling_stiffness *= factor;
        scaled.coupling_damping *= factor;
        loop_push_result push = loop_push(&scaled, &limits);
        assert_true(isfinite(push.rest_time) == !i);
        if (i) continue;
        double depth = 500 * 10e-3 / (500 + scaled.coupling_stiffness); /* m, where hand spring and coupling balance */
        assert_true(push.force > scaled.coupling_stiffness * depth);
        assert_true(push.energy == 0.0);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(without_delay_half_a_period_of_the_spring_and_the_damper),
        cmocka_unit_test(a_delayed_spring_needs_damping_for_the_delay),
        cmocka_unit_test(a_slow_hand_oscillates_when_the_delay_eats_its_damping),
        cmocka_unit_test(theory_and_simulation_agree),
        cmocka_unit_test(a_push_rests_only_in_a_stable_loop),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
