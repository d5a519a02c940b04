/* Tests that playing a log shows the same results as trocar-replay. */
#include "view/stream/playback.h"

#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "shared/poselog.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "check.h"

static void golden_trace_is_reproduced(void **unused) {
    (void)unused;
    trocar_scene *s;
    trocar_error why, cut;
    timeline t;
    assert_int_equal(trocar_scene_load(MESHES "/figure8.yaml", &s, &why), TROCAR_OK);
    assert_int_equal(timeline_create(&t, false, 1, &why), TROCAR_OK);
    assert_int_equal(playback_run(s, SOURCE_DIR "/tests/traces/figure8.log", &t, &cut, &why), TROCAR_OK);

    wrench_log golden;
    assert_int_equal(wrench_log_read(SOURCE_DIR "/tests/traces/figure8-golden.log", &golden, &why), TROCAR_OK);
    int64_t start = golden.wrenches[0].utime;
    int compared = 0, punctures = 0;
    for (int64_t i = 0; i < t.sample_end; i++) punctures += t.samples[i].membrane >= 0;
    for (int g = 0, i = 0; g < golden.count; g++) {
        double time = 1e-6 * (double)(golden.wrenches[g].utime - start);
        while (i < t.sample_end && t.samples[i].time < time - 1e-6) i++;
        if (i == t.sample_end || fabs(t.samples[i].time - time) > 1e-6) continue;
        for (int a = 0; a < 3; a++) assert_close(t.samples[i].force[a], golden.wrenches[g].force[a], 0.02); /* 1 % of the peak */
        compared++;
    }
    wrench_log_free(&golden);
    assert_true(compared > 50);
    assert_int_equal(punctures, 2);
    assert_true(t.picture_end >= (int64_t)(PLAYBACK_HZ * t.now));
    timeline_free(&t);
    trocar_scene_free(s);
}

static double time_of_picture(const byte_buffer *encoded) {
    double time;
    memcpy(&time, encoded->data + 8, sizeof time);
    return time;
}

/* The wrench shown for a moment is that of exactly this tick, not of a neighbouring snapshot or sample. */
static void moment_matches_its_tick(void **unused) {
    (void)unused;
    trocar_scene *s;
    trocar_error why, cut;
    wrench_log golden;
    assert_int_equal(trocar_scene_load(MESHES "/figure8.yaml", &s, &why), TROCAR_OK);
    assert_int_equal(wrench_log_read(SOURCE_DIR "/tests/traces/figure8-golden.log", &golden, &why), TROCAR_OK);
    for (int part = 1; part <= 3; part++) {
        const trocar_needle_wrench_t *kept = &golden.wrenches[part * (golden.count - 1) / 3];
        double time = 1e-6 * (double)(kept->utime - golden.wrenches[0].utime);
        timeline t;
        assert_int_equal(timeline_create(&t, false, 1, &why), TROCAR_OK);
        assert_int_equal(playback_moment(s, SOURCE_DIR "/tests/traces/figure8.log", part < 3 ? time : INFINITY, &t, &cut, &why), TROCAR_OK);
        assert_true(t.picture_end == 1 && t.sample_end == 1);
        assert_close(time_of_picture(&t.pictures[0]), time, 1e-6);
        assert_close(t.samples[0].time, time, 1e-6);
        for (int a = 0; a < 3; a++) assert_close(t.samples[0].force[a], kept->force[a], 0.02);
        timeline_free(&t);
    }
    wrench_log_free(&golden);
    trocar_scene_free(s);
}

/* A seed dropped at the deepest point enters the tissue only when the needle is drawn back past it. */
static void seeds_of_a_log_are_shown(void **unused) {
    (void)unused;
    enum { STEPS = 100, PERIOD = 4000 /* us */ };
    static char path[] = "/tmp/trocar-seeds-XXXXXX";
    trocar_error why, cut;
    trocar_scene *s;
    timeline t;
    close(mkstemp(path));
    lcm_eventlog_t *log = lcm_eventlog_create(path, "w");
    for (int i = 0; i <= 2 * STEPS; i++) {
        double tip = -0.002 + 0.0005 * (i <= STEPS ? i : 2 * STEPS - i);
        trocar_needle_pose_t m = message_of_pose((pose){v3(0.005, 0.003, tip - 0.2), {1, 0, 0, 0}}, 1000000 + PERIOD * i, 7, i);
        trocar_command_t drop = {.utime = m.utime, .session = 7, .command = TROCAR_COMMAND_T_DROP_SEED, .seeds = 1};
        assert_int_equal(log_write_pose(log, &m, path, &why), TROCAR_OK);
        if (i == STEPS) assert_int_equal(log_write_command(log, &drop, path, &why), TROCAR_OK);
    }
    lcm_eventlog_destroy(log);
    assert_int_equal(trocar_scene_load(MESHES "/figure8.yaml", &s, &why), TROCAR_OK);
    for (int late = 0; late < 2; late++) {
        assert_int_equal(timeline_create(&t, false, 1, &why), TROCAR_OK);
        assert_int_equal(playback_moment(s, path, 1e-6 * PERIOD * (STEPS + (late ? STEPS / 2 : 2)), &t, &cut, &why), TROCAR_OK);
        const byte_buffer *picture = &t.pictures[t.picture_end - 1];
        uint32_t kind, size, after = 0;
        memcpy(&size, picture->data + 4, sizeof size);
        after = 8 + (size + 7) / 8 * 8; /* the seed data follow the snapshot */
        int32_t counts[3];
        memcpy(&kind, picture->data + after, sizeof kind);
        memcpy(counts, picture->data + after + 8, sizeof counts); /* number of needles, seeds in the tissue, and seeds in the needles */
        assert_int_equal(kind, SECTION_SEEDS);
        assert_true(counts[0] == 1 && counts[1] == late && counts[2] == !late);
        timeline_free(&t);
    }
    trocar_scene_free(s);
    remove(path);
}

static void moment_after_the_end_is_refused(void **unused) {
    (void)unused;
    trocar_scene *s;
    trocar_error why, cut;
    timeline t;
    assert_int_equal(trocar_scene_load(MESHES "/figure8.yaml", &s, &why), TROCAR_OK);
    assert_int_equal(timeline_create(&t, false, 1, &why), TROCAR_OK);
    assert_int_equal(playback_moment(s, SOURCE_DIR "/tests/traces/figure8.log", 99, &t, &cut, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "--at 99 s is after the last pose"));
    timeline_free(&t);
    trocar_scene_free(s);
}

/* Plays the first quarter of a recording, which ends in an incomplete event. */
static void truncated_log_plays_to_its_last_event(void **unused) {
    (void)unused;
    static unsigned char bytes[1 << 18];
    char path[] = "/tmp/trocar-test-playback-XXXXXX";
    FILE *whole = fopen(SOURCE_DIR "/tests/traces/figure8.log", "r"), *part = fdopen(mkstemp(path), "w");
    size_t length = fread(bytes, 1, sizeof bytes, whole);
    assert_int_equal(fwrite(bytes, 1, length / 4 + 50, part), length / 4 + 50);
    fclose(whole);
    fclose(part);

    trocar_scene *s;
    trocar_error why, cut;
    timeline t;
    pose_log poses;
    assert_int_equal(pose_log_read_to_cut(path, &poses, &cut, &why), TROCAR_OK);
    double end = pose_log_time(&poses, poses.count - 1);
    pose_log_free(&poses);
    assert_int_equal(trocar_scene_load(MESHES "/figure8.yaml", &s, &why), TROCAR_OK);
    assert_int_equal(timeline_create(&t, false, 1, &why), TROCAR_OK);
    assert_int_equal(playback_run(s, path, &t, &cut, &why), TROCAR_OK);
    assert_non_null(strstr(cut.text, "truncated"));
    assert_true(end > 0.3 && t.now == end && time_of_picture(&t.pictures[t.picture_end - 1]) == end);
    timeline_free(&t);
    unlink(path);
    trocar_scene_free(s);
}

static void missing_log_is_reported(void **unused) {
    (void)unused;
    trocar_scene *s;
    trocar_error why, cut;
    timeline t;
    assert_int_equal(trocar_scene_load(MESHES "/figure8.yaml", &s, &why), TROCAR_OK);
    assert_int_equal(timeline_create(&t, false, 1, &why), TROCAR_OK);
    assert_int_equal(playback_run(s, "none.log", &t, &cut, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "none.log"));
    timeline_free(&t);
    trocar_scene_free(s);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(golden_trace_is_reproduced),
        cmocka_unit_test(moment_matches_its_tick),
        cmocka_unit_test(seeds_of_a_log_are_shown),
        cmocka_unit_test(moment_after_the_end_is_refused),
        cmocka_unit_test(truncated_log_plays_to_its_last_event),
        cmocka_unit_test(missing_log_is_reported),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
