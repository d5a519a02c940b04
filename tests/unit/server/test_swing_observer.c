/* Tests the swing observer with oscillations of known damping. */
#include <math.h>

#include "coupling/swing_observer.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static const int64_t MS = 1000000;

typedef struct {
    double amplitude;        /* m, of the oscillation */
    double frequency;        /* Hz */
    double damping;          /* fraction of critical damping; if negative, the oscillation grows */
    double force;            /* N, amplitude of the force */
    double drift;            /* m/s */
    vec3 direction;
} motion;

/* Returns the largest number of consecutive oscillations reported during this time. */
static int longest_row(const motion *m, double seconds) {
    swing_observer s;
    swing_begin(&s, v3(0.1, 0.2, 0.3), 0);
    int longest = 0;
    for (int64_t ms = 1; ms < 1000 * seconds; ms++) {
        double t = 1e-3 * (double)ms, w = 2 * M_PI * m->frequency;
        double x = m->amplitude * exp(-m->damping * w * t) * sin(w * t);
        int lasting = swing_observe(&s, v3_axpy(x + m->drift * t, m->direction, v3(0.1, 0.2, 0.3)), v3(m->force * cos(w * t), 0, 0), ms * MS);
        if (lasting > longest) longest = lasting;
    }
    return longest;
}

static const vec3 X = {1, 0, 0}, OBLIQUE = {0.6, -0.48, 0.64};

static void a_steady_oscillation_is_reported_swing_by_swing(void **unused) {
    (void)unused;
    for (double frequency = 4; frequency <= 40; frequency *= 1.3) {
        motion m = {1e-3, frequency, 0, 0.5, 0, frequency > 10 ? X : OBLIQUE};
        assert_in_range(longest_row(&m, 1.0), (int)(2 * frequency) - 3, (int)(2 * frequency) + 1);
    }
    motion small = {0.12e-3, 10, 0, 0.5, 0, OBLIQUE}, growing = {0.2e-3, 12, -0.02, 0.5, 0, X}, drifting = {1e-3, 15, 0, 0.5, 2e-3, X};
    assert_true(longest_row(&small, 1.0) > 15 && longest_row(&growing, 1.0) > 15 && longest_row(&drifting, 1.0) > 15);
}

/* In one period, an oscillation decays by exp(-2 pi times the damping), which is 0.9 at 1.7 %. The first two half-oscillations have nothing to be compared
   with, and the first is half as long as the others. */
static void an_oscillation_that_dies_away_is_not_reported(void **unused) {
    (void)unused;
    for (double frequency = 4; frequency <= 40; frequency *= 1.3) {
        motion damped = {5e-3, frequency, 0.07, 0.5, 0, X}, hardly = {5e-3, frequency, 0.01, 0.5, 0, X};
        assert_in_range(longest_row(&damped, 2.0), 0, 3);
        assert_true(longest_row(&hardly, 2.0) > 3);
    }
}

static void other_motions_are_not_reported(void **unused) {
    (void)unused;
    const motion slow = {10e-3, 1.6, 0, 1, 0, X}, tremor = {0.08e-3, 10, 0, 0.2, 0, X}, free = {5e-3, 8, 0, 0.004, 0, X}, push = {0.2e-3, 10, 0, 0.5, 0.1, X};
    assert_int_equal(longest_row(&slow, 3.0), 0);
    assert_int_equal(longest_row(&tremor, 3.0), 0);
    assert_int_equal(longest_row(&free, 3.0), 0);   /* the needle moves through air */
    assert_int_equal(longest_row(&push, 3.0), 0);   /* the hand never reverses */
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_steady_oscillation_is_reported_swing_by_swing),
        cmocka_unit_test(an_oscillation_that_dies_away_is_not_reported),
        cmocka_unit_test(other_motions_are_not_reported),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
