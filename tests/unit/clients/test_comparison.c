#include "replay/comparison.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>

#include "check.h"

enum { COUNT = 100, GOLDEN = COUNT / 5, FIRST = 20 /* FIRST: index of a pose in the recording */ };

/* Creates a replay in which every other pose is lost and fz decreases linearly to -9.9 N. */
static void make_replay(trocar_needle_wrench_t replayed[COUNT]) {
    for (int i = 0; i < COUNT; i++)
        replayed[i] = (trocar_needle_wrench_t){.session = 4, .pose_seq = FIRST + 2 * i, .pose_utime = 1000000 + 2000 * i, .membrane = -1,
                                               .raw_force = {0, 0, -0.1 * i}, .raw_torque = {1e-3, 0, 0}};
}

/* A replay, and the golden wrenches, which are every fifth wrench of the replay. */
typedef struct {
    trocar_needle_wrench_t replayed[COUNT], golden[GOLDEN];
} fixture;

static int set_up(void **state) {
    fixture *f = calloc(1, sizeof *f);
    make_replay(f->replayed);
    for (int i = 0; i < GOLDEN; i++) f->golden[i] = f->replayed[5 * i];
    *state = f;
    return 0;
}

static int tear_down(void **state) {
    free(*state);
    return 0;
}

/* Compares the replay with a log of the golden wrenches. */
static trocar_status try_to_compare(const fixture *f, double tolerance, comparison *c, trocar_error *why) {
    char path[] = "/tmp/test_comparison.XXXXXX";
    close(mkstemp(path));
    lcm_eventlog_t *log = lcm_eventlog_create(path, "w");
    for (int i = 0; i < GOLDEN; i++) assert_int_equal(log_write_wrench(log, &f->golden[i], path, why), TROCAR_OK);
    lcm_eventlog_destroy(log);
    trocar_status status = comparison_begin(c, path, f->replayed[0].session, tolerance, why);
    for (int i = 0; i < COUNT && status == TROCAR_OK; i++) status = comparison_add(c, &f->replayed[i], why);
    if (status == TROCAR_OK) status = comparison_end(c, why);
    comparison_free(c);
    c->path = "golden.log";
    unlink(path);
    return status;
}

static comparison compare(const fixture *f, double tolerance) {
    trocar_error why;
    comparison c;
    if (try_to_compare(f, tolerance, &c, &why) != TROCAR_OK) fail_msg("%s", why.text);
    return c;
}

static void equal_wrenches_match_exactly(void **state) {
    comparison c = compare(*state, 0);
    assert_int_equal(c.compared, COUNT / 5);
    assert_int_equal(c.differing, 0);
    assert_true(c.largest.share == 0);
}

/* fz changes by 0.1 N from one wrench to the next, so a wrench that is off by 0.15 N lies 0.05 N outside the range of its neighbours. */
static void first_difference_is_kept(void **state) {
    fixture *f = *state;
    f->golden[4].raw_force[2] -= 0.09;
    f->golden[7].raw_force[2] -= 0.15;
    f->golden[9].raw_force[2] -= 0.25;
    comparison c = compare(f, 1e-4);
    assert_int_equal(c.differing, 2);
    assert_int_equal(c.first.golden.pose_seq, f->golden[7].pose_seq);
    assert_int_equal(c.first.replayed.pose_seq, f->replayed[35].pose_seq);
    assert_int_equal(c.first.component, 2);
    assert_close(c.first.off, 0.05, 1e-12);
    assert_close(c.largest.off, 0.15, 1e-12);
    assert_close(c.largest.share, 0.15 / 9.5, 1e-12);
    assert_int_equal(compare(f, 0.01).differing, 1);
    assert_int_equal(compare(f, 0.02).differing, 0);
}

/* Of 20 golden wrenches, the third is off by more than the peak force, and the last by 2 % of it. */
static void quantiles_and_end_are_reported(void **state) {
    fixture *f = *state;
    f->golden[2].raw_torque[0] += 5e-3;
    f->golden[19].raw_torque[0] -= 0.02 * 6e-3;
    comparison c = compare(f, 0);
    assert_int_equal(c.differing, 2);
    assert_int_equal(c.last.golden.pose_seq, f->golden[19].pose_seq);
    assert_int_equal(c.last.component, 3);
    assert_close(c.last.share, 0.02, 1e-12);
    assert_close(comparison_quantile(&c, 0.90), 0.001, 1e-12); /* 18 are equal */
    assert_close(comparison_quantile(&c, 0.95), 0.02, 1.1e-3);
    assert_close(comparison_quantile(&c, 1.0), 5.0 / 6.0, 1.1e-3);
}

/* Errors in components close to zero are given relative to 0.1 N and 2 mN m. */
static void small_components_use_a_minimum_peak(void **state) {
    fixture *f = *state;
    f->golden[3].raw_force[0] = 0.9e-3;
    f->golden[3].raw_torque[0] += 18e-6;
    assert_int_equal(compare(f, 0.01).differing, 0);
    f->golden[3].raw_torque[0] += 4e-6;
    comparison c = compare(f, 0.01);
    assert_int_equal(c.differing, 1);
    assert_int_equal(c.first.component, 3);
}

static void non_finite_values_differ(void **state) {
    fixture *f = *state;
    f->replayed[50].raw_force[1] = NAN;
    comparison c = compare(f, 1);
    assert_int_equal(c.differing, 1);
    assert_int_equal(c.first.golden.pose_seq, f->golden[10].pose_seq);
}

static void rendered_wrenches_are_not_compared(void **state) {
    fixture *f = *state;
    f->golden[3].force[0] = 5;
    assert_int_equal(compare(f, 0).differing, 0);
}

static void wrenches_of_another_recording_are_refused(void **state) {
    fixture *f = *state;
    trocar_error why;
    comparison c;
    f->golden[3].session = 5;
    assert_int_equal(compare(f, 0).compared, COUNT / 5 - 1);
    f->golden[GOLDEN - 1].pose_seq = FIRST + 2 * COUNT;
    assert_int_equal(try_to_compare(f, 0, &c, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, ": a wrench answers pose 220, which was not replayed"));
    f->golden[7].pose_seq = f->golden[6].pose_seq - 1;
    assert_int_equal(try_to_compare(f, 0, &c, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, ": a wrench answers pose 79 after one that answers pose 80: record it again, in order"));
    for (int i = 0; i < GOLDEN; i++) f->golden[i].session = 5;
    assert_int_equal(try_to_compare(f, 0, &c, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "no wrench answers"));
}

static void wrenches_whose_pose_was_not_recorded_are_left_out(void **state) {
    fixture *f = *state;
    f->golden[0].pose_seq = 3; /* a pose from before the recording began */
    f->golden[5].pose_seq++;    /* a pose that the replay lost */
    comparison c = compare(f, 0);
    assert_int_equal(c.compared, COUNT / 5 - 2);
    assert_int_equal(c.differing, 0);
    assert_int_equal(c.unrecorded, 2);
    char *text;
    size_t size;
    FILE *file = open_memstream(&text, &size);
    comparison_print(&c, file);
    fclose(file);
    assert_non_null(strstr(text, "2 wrenches ignored: the recording lacks the poses that they answer\n"));
    free(text);
    trocar_error why;
    for (int i = 0; i <= COUNT / 10; i++) f->golden[i].pose_seq = i; /* most of the poses were lost */
    assert_int_equal(try_to_compare(f, 0, &c, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "11 of 20 wrenches answer poses that are not in the recording"));
}

static void print_reports_the_difference(void **state) {
    fixture *f = *state;
    f->golden[7].raw_force[2] -= 0.15;
    comparison c = compare(f, 1e-4);
    char *text;
    size_t size;
    FILE *file = open_memstream(&text, &size);
    comparison_print(&c, file);
    fclose(file);
    assert_non_null(strstr(text, "golden.log: 1 of 20 wrenches differ\n"));
    assert_non_null(strstr(text, "first:   fz off by 0.05 N, 0.53 % of its peak, at 0.070 s, pose 90\n"));
    assert_non_null(strstr(text, "golden:  fz -3.65 N"));
    assert_non_null(strstr(text, "replay:  fz -3.5 N"));
    free(text);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)

static void wrenches_of_a_second_server_are_ignored(void **state) {
    fixture *f = *state;
    f->golden[6].server = 12;
    f->golden[6].raw_force[2] = 50;
    comparison c = compare(f, 0);
    assert_int_equal(c.foreign, 1);
    assert_int_equal(c.compared, COUNT / 5 - 1);
    assert_int_equal(c.differing, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(wrenches_of_a_second_server_are_ignored, set_up, tear_down),
        TEST(equal_wrenches_match_exactly),
        TEST(first_difference_is_kept),
        TEST(quantiles_and_end_are_reported),
        TEST(small_components_use_a_minimum_peak),
        TEST(non_finite_values_differ),
        TEST(rendered_wrenches_are_not_compared),
        TEST(wrenches_whose_pose_was_not_recorded_are_left_out),
        TEST(wrenches_of_another_recording_are_refused),
        TEST(print_reports_the_difference),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
