/* Tests that timed ticks have the requested number of contacts and that the times are plausible. */
#include <setjmp.h>
#include <string.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "bench/tick_timing.h"
#include "host.h"

#include <cmocka.h>

static host body;

static int create(void **state) {
    (void)state;
    body = host_open(MESHES "/figure8.yaml");
    return 0;
}

static int destroy(void **state) {
    (void)state;
    host_close(&body);
    return 0;
}

/* Directly above the gland, with the tip 1 mm in front of the skin. */
static const pose START = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};

static timing_case five_contacts(timed_motion motion, int ticks) {
    return (timing_case){.start = START, .dt = 1e-3, .contacts = 5, .ticks = ticks, .motion = motion};
}

static void sweeps_with_the_requested_contacts(void **state) {
    (void)state;
    trocar_error why;
    tick_timing row;
    timing_case wanted = five_contacts(TIMED_SWEEP, 50);
    assert_int_equal(tick_timing_measure(body.sim, body.scene, &wanted, &row, &why), TROCAR_OK);
    assert_int_equal(row.time.count, 50);
    assert_int_equal(row.contacts, 5);
    assert_true(row.passes >= 1.0);
    assert_int_equal(row.unstable, 0);
}

/* All timed ticks have the requested number of contacts, although a needle that advanced for that many ticks would end up with more. */
static void advances_with_the_requested_contacts(void **state) {
    (void)state;
    trocar_error why;
    tick_timing row;
    timing_case wanted = five_contacts(TIMED_ADVANCE, 1000);
    assert_int_equal(tick_timing_measure(body.sim, body.scene, &wanted, &row, &why), TROCAR_OK);
    assert_int_equal(row.time.count, 1000);
    assert_int_equal(row.contacts, 5);

    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
    assert_int_equal(trocar_sim_reset(body.sim, 0, &base, &why), TROCAR_OK);
    for (body.output.contacts = 0; body.output.contacts < 5; host_step(&body, &base)) base.position[2] += 1e-4;
    for (int i = 0; i < 1000; i++, host_step(&body, &base)) base.position[2] += 0.02e-3;
    assert_true(body.output.contacts > 5);
}

/* At least half of the ticks took the median time or longer, and together they cannot have taken longer than the elapsed time. */
static void times_do_not_exceed_elapsed_time(void **state) {
    (void)state;
    trocar_error why;
    tick_timing row;
    timing_case wanted = five_contacts(TIMED_SWEEP, 200);
    int64_t start = monotonic_ns();
    assert_int_equal(tick_timing_measure(body.sim, body.scene, &wanted, &row, &why), TROCAR_OK);
    double passed = 1e-9 * (double)(monotonic_ns() - start), median = histogram_quantile(&row.time, 0.5);
    assert_true(median > 0.0);
    assert_true(0.5 * 200 * 0.96 * median <= passed);   /* 0.96 allows for the width of a histogram bucket */
    assert_true(histogram_max(&row.time) <= passed);
}

static void reports_the_number_of_contacts(void **state) {
    (void)state;
    trocar_error why;
    tick_timing row;
    timing_case wanted = five_contacts(TIMED_SWEEP, 10);
    wanted.contacts = TROCAR_MAX_CONTACTS;
    assert_int_equal(tick_timing_measure(body.sim, body.scene, &wanted, &row, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "prostate-570.msh"));
    assert_non_null(strstr(why.text, "not 64"));
    wanted.start.position.x = 1.0;   /* past the body */
    wanted.contacts = 1;
    assert_int_equal(tick_timing_measure(body.sim, body.scene, &wanted, &row, &why), TROCAR_BAD_INPUT);
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
