/* Tests the phase lock with a simulated device: jittery arrivals, a device clock that runs fast or slow, other rates, and silence. */
#include "phase_lock.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <cmocka.h>

enum { PERIOD = 1000000, SETTLE = 1000, TICKS = 5000 }; /* ns; ticks */

typedef struct {
    double period, jitter;   /* ns; period: mean interval between poses; jitter: half-width of its random deviation */
    double start;            /* ns, time of the first pose */
} device;

typedef struct {
    double age, oldest;      /* ns; age: mean age of the newest pose at a tick, after the first SETTLE ticks; oldest: the maximum */
    double rate;             /* ratio of the loop's mean period to its nominal one */
    int64_t largest;         /* ns, shift */
} outcome;

static double uniform(double low, double high) { return low + (high - low) * rand() / RAND_MAX; }

static outcome run(device d) {
    phase_lock lock = {.period = PERIOD};
    outcome o = {0};
    double next = d.start + uniform(-d.jitter, d.jitter), expected = d.start;
    int64_t deadline = 0, received = 0, settled = 0;
    for (int tick = 0; tick < TICKS; tick++) {
        for (; next <= (double)deadline; next = fmax(next, expected + uniform(-d.jitter, d.jitter))) {
            received = (int64_t)next;
            expected += d.period;
        }
        if (tick == SETTLE) settled = deadline;
        if (tick >= SETTLE) {
            double age = (double)(deadline - received);
            o.age += age / (TICKS - SETTLE);
            o.oldest = fmax(o.oldest, age);
        }
        int64_t shift = phase_lock_shift(&lock, deadline, received);
        o.largest = llabs(shift) > o.largest ? llabs(shift) : o.largest;
        deadline += PERIOD + shift;
    }
    o.rate = (double)(deadline - settled) / ((double)PERIOD * (TICKS - SETTLE));
    return o;
}

static void poses_are_answered_at_once(void **unused) {
    (void)unused;
    for (int i = 0; i < 50; i++) {
        double drift = uniform(-2e-4, 2e-4);
        outcome o = run((device){PERIOD * (1.0 + drift), 20e3, uniform(1, PERIOD)});
        assert_true(o.age > 20e3 && o.age < 120e3);
        assert_true(o.oldest < 0.3 * PERIOD); /* no pose arrives too late for its tick */
        assert_true(fabs(o.rate - 1.0 - drift) < 2e-5);
        assert_true(o.largest <= PERIOD / 100);
    }
}

static void a_device_of_half_the_rate_is_followed(void **unused) {
    (void)unused;
    outcome o = run((device){2 * PERIOD, 20e3, 0.3 * PERIOD});
    assert_true(o.age < 120e3 + 0.5 * PERIOD && o.oldest < 1.3 * PERIOD);
}

static void other_rates_do_no_harm(void **unused) {
    (void)unused;
    const double periods[] = {0.7, 0.97, 1.3, 1.43, 7.1};
    for (int i = 0; i < 5; i++) {
        outcome o = run((device){periods[i] * PERIOD, 20e3, 0.5 * PERIOD});
        assert_true(fabs(o.rate - 1.0) <= 0.01);
        assert_true(o.largest <= PERIOD / 100);
    }
}

static void silence_leaves_the_loop_as_it_is(void **unused) {
    (void)unused;
    phase_lock lock = {.period = PERIOD};
    assert_int_equal(phase_lock_shift(&lock, 5 * PERIOD, 0), 0);
    phase_lock_shift(&lock, 6 * PERIOD, 5 * PERIOD + 1000);
    assert_int_equal(phase_lock_shift(&lock, 7 * PERIOD, 5 * PERIOD + 1000), 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(poses_are_answered_at_once),
        cmocka_unit_test(a_device_of_half_the_rate_is_followed),
        cmocka_unit_test(other_rates_do_no_harm),
        cmocka_unit_test(silence_leaves_the_loop_as_it_is),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
