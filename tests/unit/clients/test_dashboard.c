#include "top/dashboard.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

#include "trocar_needle_wrench_t.h"

static dashboard_line lines[DASHBOARD_LINES];

static trocar_loop_timing_t sample_timing(void) {
    trocar_loop_timing_t t = {.ticks = 5000, .rate_hz = 1000, .lateness_p50 = 35e-6, .lateness_p99 = 1.25e-3, .lateness_max = 2,
                              .misses = 7, .snapshot_age = 3e-3};
    t.stage_mean[3] = 12.34e-6;
    t.lateness_bins[10] = 99;
    t.lateness_bins[20] = 1;
    t.compute_bins[4] = 100;
    return t;
}

static dashboard sample(void) {
    dashboard d = {0};
    trocar_loop_timing_t timing = sample_timing();
    trocar_status_t status = {.owner = 42, .scene = "scene.yaml", .message = "", .poses_accepted = 123, .pose_age = 0.5e-3,
                              .needle_count = 1, .contacts = 12};
    dashboard_take_timing(&d, &timing, 10.0);
    dashboard_take_status(&d, &status, 10.0);
    return d;
}

/* Returns the line that begins with this word, as drawn at 10.1 s. Fails if there is none. */
static const dashboard_line *line_of(const dashboard *d, const char *word) {
    int count = dashboard_draw(d, 10.1, 30, lines);
    for (int i = 0; i < count; i++)
        if (strncmp(lines[i].text, word, strlen(word)) == 0) return &lines[i];
    fail_msg("no line '%s'", word);
    return NULL;
}

static void expect(const dashboard *d, const char *word, const char *text, bool alarm) {
    const dashboard_line *line = line_of(d, word);
    if (!strstr(line->text, text) || line->alarm != alarm) fail_msg("'%s'%s, not '%s'", line->text, line->alarm ? " (alarm)" : "", text);
}

static void numbers_have_readable_units(void **state) {
    (void)state;
    dashboard d = sample();
    expect(&d, "trocar", "scene.yaml, 1000 Hz, tick 5000", false);
    expect(&d, "needle", "of session 42, 12 contacts", false);
    expect(&d, "lateness  ", "35.0 us    1.25 ms     2.00 s", false);
    expect(&d, "worker", "waiting for 3.00 ms", false);
    expect(&d, "  mean", "0.00     0.00     0.00    12.34     0.00     0.00", false);
    expect(&d, "poses", "taken 123", false);
}

/* Misses from before the dashboard started are shown without an alarm. New misses and nonzero error counters raise one. */
static void faults_raise_alarms(void **state) {
    (void)state;
    dashboard d = sample();
    expect(&d, "loop", "missed 7, allocations 0", false);
    trocar_loop_timing_t next = sample_timing();
    next.ticks += 100, next.misses++;
    dashboard_take_timing(&d, &next, 10.1);
    expect(&d, "loop", "missed 8", true);
    d = sample();
    d.timing.allocations = 1;
    expect(&d, "loop", "allocations 1", true);
    d = sample();
    d.needles[0].poses_jumped = 3;
    expect(&d, "            too fast", "too fast 3", true);
    d.needles[0].energy_lowest = -2e-3;
    expect(&d, "wrenches", "dropped 0", false);
    expect(&d, "energy", "lowest -2.0 mJ", true);
    d.needles[0].flags = TROCAR_NEEDLE_WRENCH_T_STALE | TROCAR_NEEDLE_WRENCH_T_RAMPING;
    expect(&d, "needle", "stale, ramping", true);
    trocar_status_t status = {.scene = "", .message = "the worker failed", .needle_count = 1};
    dashboard_take_status(&d, &status, 10.0);
    expect(&d, "needle", "free", false);
    expect(&d, "last fault", "the worker failed", true);
    status.message = "gone\033[2J\007\n", status.scene = "\033]0;title\007/scene.yaml"; /* these texts must neither clear the terminal nor ring the bell */
    dashboard_take_status(&d, &status, 10.0);
    expect(&d, "last fault", "gone?[2J??", true);
    expect(&d, "trocar", "?]0;title?/scene.yaml", false);
}

static void alarms_are_reset_when_the_server_restarts(void **state) {
    (void)state;
    dashboard d = sample();
    trocar_loop_timing_t restarted = {.ticks = 100, .misses = 9};
    dashboard_take_timing(&d, &restarted, 10.1);
    expect(&d, "loop", "missed 9", false);
}

static void first_of_two_servers_is_shown(void **state) {
    (void)state;
    dashboard d = sample();
    trocar_loop_timing_t other = {.server = 77, .ticks = 1};
    trocar_status_t status = {.server = 77, .host = "", .scene = "other.yaml", .inverse = "", .message = "", .needle_count = 1};
    dashboard_take_timing(&d, &other, 10.05);
    dashboard_take_status(&d, &status, 10.05);
    expect(&d, "trocar", "scene.yaml, 1000 Hz, tick 5000", false);
    expect(&d, "two servers", "000000000000004d: stop one", true);
    dashboard_take_timing(&d, &other, 12); /* by now, the first server has gone silent */
    dashboard_take_status(&d, &status, 12);
    expect(&d, "trocar", "other.yaml, 0 Hz, tick 1", false);
}

static void silence_and_invalid_messages_are_reported(void **state) {
    (void)state;
    dashboard d = {0};
    assert_int_equal(dashboard_draw(&d, 10, 30, lines), 1);
    assert_true(lines[0].alarm && strstr(lines[0].text, "no server was heard"));
    d = sample();
    d.foreign = 2;
    dashboard_draw(&d, 15.0, 30, lines);
    assert_true(lines[0].alarm && strstr(lines[0].text, "2 messages of another version"));
    assert_true(lines[2].alarm && strcmp(lines[2].text, "server      silent for 5 s") == 0);
}

/* Counts of 99 and 100 are drawn at full height, a count of 1 at a third of it. Bin 10 is in column 11 after the axis; bin 4 of the compute time is in
   column 42. */
static void histograms_accumulate_on_logarithmic_axes(void **state) {
    (void)state;
    dashboard d = sample();
    int count = dashboard_draw(&d, 10.1, 25, lines), rows = 0, full = 0, low = 0;
    for (int i = 0; i < count; i++) {
        if (lines[i].text[0] != '|') continue;
        rows++;
        full += lines[i].text[11] == '#' && lines[i].text[38 + 4] == '#';
        low += lines[i].text[21] == '#';
        assert_true(lines[i].text[12] == ' ' && strlen(lines[i].text) == 70);
    }
    assert_true(rows > 5 && full == rows && low == (rows + 2) / 3);
    trocar_loop_timing_t next = sample_timing();
    dashboard_take_timing(&d, &next, 10.1);
    assert_true(d.lateness[10] == 198 && d.compute[4] == 200);
    dashboard_clear(&d);
    assert_true(d.lateness[10] == 0 && d.compute[4] == 0);
}

static void works_at_any_height(void **state) {
    (void)state;
    dashboard d = sample();
    for (int height = 0; height < 100; height++) {
        int count = dashboard_draw(&d, 10.1, height, lines);
        assert_true(count <= height && count <= DASHBOARD_LINES);
        for (int i = 0; i < count; i++) assert_true(strlen(lines[i].text) <= 72);
    }
}

static void each_needle_has_its_lines(void **state) {
    (void)state;
    dashboard d = sample();
    trocar_status_t first = {.owner = 42, .scene = "pair.yaml", .message = "", .needle_count = 2, .poses_accepted = 100, .contacts = 3};
    trocar_status_t second = {.owner = 43, .scene = "pair.yaml", .message = "", .needle_count = 2, .needle = 1, .poses_accepted = 20,
                              .contacts = 4, .flags = TROCAR_NEEDLE_WRENCH_T_STALE, .energy_lowest = -1e-3, .poses_no_needle = 5};
    first.poses_no_needle = 5;
    dashboard_take_status(&d, &first, 10.0);
    dashboard_take_status(&d, &second, 10.0);
    expect(&d, "needle 0", "of session 42, 3 contacts", false);
    expect(&d, "needle 1", "of session 43, 4 contacts, stale", true);
    expect(&d, "energy 0", "lowest 0.0 mJ", false);
    expect(&d, "energy 1", "lowest -1.0 mJ", true);
    expect(&d, "poses", "taken 120", true);
    expect(&d, "            too fast", "refused 5", true);
    second.needle = 2; /* invalid: not less than the message's `needle_count` */
    dashboard_take_status(&d, &second, 10.0);
    assert_int_equal(d.foreign, 1);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(numbers_have_readable_units),
        cmocka_unit_test(faults_raise_alarms),
        cmocka_unit_test(alarms_are_reset_when_the_server_restarts),
        cmocka_unit_test(first_of_two_servers_is_shown),
        cmocka_unit_test(silence_and_invalid_messages_are_reported),
        cmocka_unit_test(histograms_accumulate_on_logarithmic_axes),
        cmocka_unit_test(works_at_any_height),
        cmocka_unit_test(each_needle_has_its_lines),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
