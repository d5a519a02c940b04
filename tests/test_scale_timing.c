/* The worker's lateness on a mesh where it is never late, and on a clock so fast that it always is. */
#include "lockstep.h"
#include "scale_timing.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static scale_timing *measured(const motion *script, double speed, double dt, inverse_choice owner) {
    simulation_config config = lockstep_config();
    simulation s;
    report why;
    config.inverse = owner;
    static scale_timing result;
    assert_int_equal(simulation_create(&config, &s, &why), TROCAR_OK);
    scale_case wanted = {.start = lockstep_start(), .script = script, .speed = speed, .depth = 0.066, .dt = dt};
    assert_int_equal(scale_timing_measure(&s, &wanted, &result, &why), TROCAR_OK);
    simulation_free(&s);
    return &result;
}

static void crossings_are_counted_and_answered(void **unused) {
    (void)unused;
    const scale_timing *r = measured(NULL, 0.02, 1e-3, INVERSE_DENSE);
    assert_int_equal(r->ticks, 3300);
    assert_int_equal(r->tick.count, 3300);
    assert_true(r->crossings > 5 && r->crossing.count <= r->crossings);
    assert_true(r->serve.count >= r->crossings && r->serve.count < r->ticks);
    assert_true(r->most_contacts > 5);
    assert_true(r->crossing.max >= 1000000); /* an answer is there one tick after it was asked for, at the earliest */
}

/* In and out again: on the way out contact nodes go, and none of them is late. */
static void crossings_on_the_way_out_do_not_count(void **unused) {
    (void)unused;
    scale_timing in = *measured(NULL, 0.05, 1e-3, INVERSE_DENSE);
    const scale_timing *r = measured(motion_find("insert"), 0, 1e-3, INVERSE_DENSE);
    assert_int_equal(r->ticks, 3500);
    assert_in_range(r->crossings, in.crossings * 3 / 4, in.crossings * 3 / 2);
    assert_int_equal(r->late_crossings, 0);
}

/* Ticks of 0.2 us at 100 m/s: no answer can come in time. */
static void a_worker_that_is_slower_than_the_needle_is_late(void **unused) {
    (void)unused;
    const scale_timing *r = measured(NULL, 100.0, 2e-7, INVERSE_SPARSE);
    assert_true(r->late_crossings > 0 || r->late_ticks > r->ticks / 2);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(crossings_are_counted_and_answered),
        cmocka_unit_test(crossings_on_the_way_out_do_not_count),
        cmocka_unit_test(a_worker_that_is_slower_than_the_needle_is_late),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
