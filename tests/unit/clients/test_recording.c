#include "device/recording.h"
#include "insertion/step/tick.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

static trocar_error why;

/* Records 200 poses at 1 kHz. Pose k is answered after (k + 1) us, so the percentiles are known exactly. */
static recording conversation(void) {
    recording r = {.session = 5};
    pose base = {{0, 0, 0}, {1, 0, 0, 0}};
    for (int k = 0; k < 200; k++) {
        double t = 1e-3 * k;
        assert_int_equal(recording_add_pose(&r, t, base, &why), TROCAR_OK);
        trocar_needle_wrench_t w = {.session = 5, .tick = 1000 + k, .pose_seq = k, .depth = t, .contacts = k / 10, .membrane = -1};
        w.raw_force[2] = w.force[2] = -0.01 * k;
        if (k == 50) w.events = EVENT_PUNCTURED, w.membrane = 1;
        if (k >= 50) w.raw_force[2] = w.force[2] += 0.3;
        if (k == 120) w.raw_force[0] = 0.2;
        if (k == 60 || k == 61) continue;
        assert_int_equal(recording_add_wrench(&r, t + 1e-6 * (k + 1), &w, &why), TROCAR_OK);
    }
    return r;
}

static void summary_counts_and_ranks(void **state) {
    (void)state;
    recording r = conversation();
    recording_summary s;
    assert_int_equal(recording_summarise(&r, &s, &why), TROCAR_OK);
    assert_int_equal(s.sent, 200);
    assert_int_equal(s.received, 198);
    assert_int_equal(s.lost_wrenches, 2);
    assert_int_equal(s.unanswered_poses, 2);
    /* The round trips take 1 to 200 us, without 61 and 62 us, so the 99th of the 198 values is 101 us and the 197th is 199 us. */
    assert_true(fabs(s.round_trip_p50 - 101e-6) < 1e-12);
    assert_true(fabs(s.round_trip_p99 - 199e-6) < 1e-12);
    assert_true(fabs(s.round_trip_max - 200e-6) < 1e-12);
    assert_true(s.least_force[2] == -0.01 * 199 + 0.3 && s.greatest_force[2] == 0);
    assert_int_equal(s.most_contacts, 19);
    recording_free(&r);
}

/* The jump of 0.3 N at puncture is not counted, but the lateral jump of 0.2 N is. */
static void summary_finds_punctures_and_jumps(void **state) {
    (void)state;
    recording r = conversation();
    recording_summary s;
    assert_int_equal(recording_summarise(&r, &s, &why), TROCAR_OK);
    assert_int_equal(s.puncture_count, 1);
    assert_int_equal(s.punctures[0].membrane, 1);
    assert_true(fabs(s.punctures[0].time - 0.050051) < 1e-9);
    assert_true(fabs(s.punctures[0].force + 0.49) < 1e-12);
    assert_true(fabs(s.largest_jump - hypot(0.2, 0.01)) < 1e-12);
    assert_true(fabs(s.jump_time - 0.120) < 0.002);
    recording_free(&r);
}

static void axial_force_is_along_a_needle_in_any_direction(void **state) {
    (void)state;
    recording r = {.session = 5};
    pose along_x = {{0, 0, 0}, {sqrt(0.5), 0, sqrt(0.5), 0}};
    for (int k = 0; k < 2; k++) {
        assert_int_equal(recording_add_pose(&r, 1e-3 * k, along_x, &why), TROCAR_OK);
        trocar_needle_wrench_t w = {.session = 5, .tick = k, .pose_seq = k, .raw_force = {-0.6, 0.2, 0.1}, .events = k ? EVENT_PUNCTURED : 0};
        assert_int_equal(recording_add_wrench(&r, 1e-3 * k, &w, &why), TROCAR_OK);
    }
    recording_summary s;
    assert_int_equal(recording_summarise(&r, &s, &why), TROCAR_OK);
    assert_int_equal(s.puncture_count, 1);
    assert_true(fabs(s.punctures[0].force + 0.6) < 1e-12);
    recording_free(&r);
}

static void wrenches_before_the_start_are_ignored(void **state) {
    (void)state;
    recording r = conversation();
    r.start = 0.1;
    recording_summary s;
    assert_int_equal(recording_summarise(&r, &s, &why), TROCAR_OK);
    assert_int_equal(s.sent, 100);
    assert_int_equal(s.puncture_count, 0);
    assert_int_equal(s.lost_wrenches, 0);
    recording_free(&r);
}

static void invalid_wrenches_are_ignored(void **state) {
    (void)state;
    recording r = conversation();
    int before = r.received_count;
    trocar_needle_wrench_t w = {.session = 6, .pose_seq = 3};
    assert_int_equal(recording_add_wrench(&r, 1, &w, &why), TROCAR_OK);
    w = (trocar_needle_wrench_t){.session = 5, .pose_seq = 200};
    assert_int_equal(recording_add_wrench(&r, 1, &w, &why), TROCAR_OK);
    w.pose_seq = -1;
    assert_int_equal(recording_add_wrench(&r, 1, &w, &why), TROCAR_OK);
    assert_int_equal(r.received_count, before);
    recording_free(&r);
}

static char *text_of(const recording *r, void (*write)(const recording *, FILE *)) {
    char *text;
    size_t size;
    FILE *file = open_memstream(&text, &size);
    write(r, file);
    fclose(file);
    return text;
}

static int count_of(const char *line, char c) {
    int count = 0;
    for (; *line && *line != '\n'; line++) count += *line == c;
    return count;
}

static void write_mesh_csv(const recording *r, FILE *out) { recording_write_csv(r, NULL, out); }

static void csv_has_one_row_per_wrench_and_one_cell_per_column(void **state) {
    (void)state;
    recording r = conversation();
    char *text = text_of(&r, write_mesh_csv);
    int rows = 0, commas = count_of(text, ',');
    for (const char *line = text; *line; line = strchr(line, '\n') + 1, rows++) assert_int_equal(count_of(line, ','), commas);
    assert_int_equal(rows, 199);
    assert_non_null(strstr(text, ",puncture:1,"));
    free(text);
    recording_free(&r);
}

static void write_summary(const recording *r, FILE *out) {
    recording_summary s;
    recording_summarise(r, &s, &why);
    summary_write_json(&s, out);
}

static void empty_summary_is_valid_json(void **state) {
    (void)state;
    recording r = {.session = 5};
    char *text = text_of(&r, write_summary);
    assert_non_null(strstr(text, "\"round_trip_p50_s\": null"));
    assert_null(strstr(text, ": nan"));
    free(text);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(summary_counts_and_ranks),
        cmocka_unit_test(summary_finds_punctures_and_jumps),
        cmocka_unit_test(axial_force_is_along_a_needle_in_any_direction),
        cmocka_unit_test(wrenches_before_the_start_are_ignored),
        cmocka_unit_test(invalid_wrenches_are_ignored),
        cmocka_unit_test(csv_has_one_row_per_wrench_and_one_cell_per_column),
        cmocka_unit_test(empty_summary_is_valid_json),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
