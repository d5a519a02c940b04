/* Timed ticks: the needle has the contacts that were asked for, and the times are those of the ticks. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "lockstep.h"
#include "tick_timing.h"

#include <cmocka.h>

static simulation body;

static int create(void **state) {
    (void)state;
    report why;
    simulation_config config = lockstep_config();
    return simulation_create(&config, &body, &why) == TROCAR_OK ? 0 : -1;
}

static int destroy(void **state) {
    (void)state;
    simulation_free(&body);
    return 0;
}

static timing_case five_contacts(timed_motion motion, int ticks) {
    return (timing_case){.start = lockstep_start(), .dt = 1e-3, .contacts = 5, .ticks = ticks, .motion = motion};
}

static void sweeps_with_the_requested_contacts(void **state) {
    (void)state;
    report why;
    tick_timing row;
    timing_case wanted = five_contacts(TIMED_SWEEP, 50);
    assert_int_equal(tick_timing_measure(&body, &wanted, &row, &why), TROCAR_OK);
    assert_int_equal(row.time.count, 50);
    assert_int_equal(row.contacts, 5);
    assert_true(row.passes >= 1.0);
    assert_int_equal(row.unstable, 0);
}

/* All ticks have the contacts asked for, though a needle that goes on for as many has more in the end. */
static void advances_with_the_requested_contacts(void **state) {
    (void)state;
    report why;
    tick_timing row;
    timing_case wanted = five_contacts(TIMED_ADVANCE, 1000);
    assert_int_equal(tick_timing_measure(&body, &wanted, &row, &why), TROCAR_OK);
    assert_int_equal(row.time.count, 1000);
    assert_int_equal(row.contacts, 5);

    simulation_config config = lockstep_config();
    lockstep *l = lockstep_create(&config, lockstep_start());
    while (l->wrench.contacts < 5) lockstep_move(l, v3(0, 0, 1e-4), 1e-3, 1e-3);
    lockstep_move(l, v3(0, 0, 0.02), 1.0, 1e-3);
    assert_true(l->wrench.contacts > 5);
    lockstep_free(l);
}

/* At least half of the ticks took the median or longer, all within the time that passed. */
static void times_do_not_exceed_elapsed_time(void **state) {
    (void)state;
    report why;
    tick_timing row;
    timing_case wanted = five_contacts(TIMED_SWEEP, 200);
    int64_t start = monotonic_ns();
    assert_int_equal(tick_timing_measure(&body, &wanted, &row, &why), TROCAR_OK);
    double passed = 1e-9 * (double)(monotonic_ns() - start), median = histogram_quantile(&row.time, 0.5);
    assert_true(median > 0.0);
    assert_true(0.5 * 200 * 0.96 * median <= passed);   /* 0.96: width of the histogram's buckets */
    assert_true(histogram_max(&row.time) <= passed);
}

static void reports_the_number_of_contacts(void **state) {
    (void)state;
    report why;
    tick_timing row;
    timing_case wanted = five_contacts(TIMED_SWEEP, 10);
    wanted.contacts = MAX_CONTACTS;
    assert_int_equal(tick_timing_measure(&body, &wanted, &row, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "prostate-570.msh"));
    assert_non_null(strstr(why.text, "not 64"));
    wanted.start.position.x = 1.0;   /* past the body */
    wanted.contacts = 1;
    assert_int_equal(tick_timing_measure(&body, &wanted, &row, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "meets 0 contact nodes"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sweeps_with_the_requested_contacts),
        cmocka_unit_test(advances_with_the_requested_contacts),
        cmocka_unit_test(times_do_not_exceed_elapsed_time),
        cmocka_unit_test(reports_the_number_of_contacts),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
