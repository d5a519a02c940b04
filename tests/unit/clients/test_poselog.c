#include "shared/poselog.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>

static char path[] = "/tmp/trocar-test-poselog-XXXXXX";

static int make_file(void **state) {
    (void)state;
    int descriptor = mkstemp(path);
    return descriptor < 0 ? -1 : close(descriptor);
}

static int remove_file(void **state) {
    (void)state;
    return unlink(path);
}

static trocar_needle_pose_t sample(int64_t k) {
    pose p = {{0.001 * (double)k, 0, -0.2}, {1, 0, 0, 0}};
    return message_of_pose(p, 1000000 + 1000 * k, 7, k);
}

/* Writes `count` poses, with wrenches on another channel in between. `change` may corrupt the pose at `where`. */
static void write_log(int count, int where, void (*change)(trocar_needle_pose_t *)) {
    trocar_error why;
    lcm_eventlog_t *log = lcm_eventlog_create(path, "w");
    for (int k = 0; k < count; k++) {
        trocar_needle_pose_t p = sample(k);
        trocar_needle_wrench_t w = {.pose_utime = p.utime, .tick = k};
        if (change && k == where) change(&p);
        assert_int_equal(log_write_pose(log, &p, path, &why), TROCAR_OK);
        assert_int_equal(log_write_wrench(log, &w, path, &why), TROCAR_OK);
    }
    lcm_eventlog_destroy(log);
}

static void overwrite(long offset, const char *bytes, size_t count) {
    FILE *file = fopen(path, "r+");
    fseek(file, offset, SEEK_SET);
    fwrite(bytes, 1, count, file);
    fclose(file);
}

static void expect_bad(const char *place, const char *reason) {
    trocar_error why;
    pose_log log;
    assert_int_equal(pose_log_read(path, &log, &why), TROCAR_BAD_INPUT);
    if (!strstr(why.text, path) || !strstr(why.text, place) || !strstr(why.text, reason)) fail_msg("message: %s", why.text);
    assert_null(log.poses);
}

/* Compares the encoded messages, because padding in the structs may differ. */
static void assert_same_pose(const trocar_needle_pose_t *a, const trocar_needle_pose_t *b) {
    uint8_t bytes[2][256];
    int size = trocar_needle_pose_t_encode(bytes[0], 0, sizeof bytes[0], a);
    assert_true(size > 0 && trocar_needle_pose_t_encode(bytes[1], 0, sizeof bytes[1], b) == size);
    assert_memory_equal(bytes[0], bytes[1], (size_t)size);
}

static void assert_same_probe_pose(const trocar_probe_pose_t *a, const trocar_probe_pose_t *b) {
    uint8_t bytes[2][256];
    int size = trocar_probe_pose_t_encode(bytes[0], 0, sizeof bytes[0], a);
    assert_true(size > 0 && trocar_probe_pose_t_encode(bytes[1], 0, sizeof bytes[1], b) == size);
    assert_memory_equal(bytes[0], bytes[1], (size_t)size);
}

static void reads_what_was_written(void **state) {
    (void)state;
    trocar_error why;
    pose_log log;
    write_log(100, -1, NULL);
    assert_int_equal(pose_log_read(path, &log, &why), TROCAR_OK);
    assert_int_equal(log.count, 100);
    for (int k = 0; k < 100; k++) {
        trocar_needle_pose_t p = sample(k);
        assert_same_pose(&log.poses[k], &p);
    }
    pose_log_free(&log);
}

enum { POSE_EVENT = 28 + 11 + 100, WRENCH_EVENT = 28 + 13 + 180, PAIR = POSE_EVENT + WRENCH_EVENT };

/* A log that ends in the middle of an event is refused. No length field may cause a crash or a huge allocation. */
static void refuses_truncated_logs(void **state) {
    (void)state;
    write_log(2, -1, NULL);
    for (long length = 2 * PAIR - 1; length > 0; length--) {
        assert_int_equal(truncate(path, length), 0);
        trocar_error why;
        pose_log log;
        bool whole = length == PAIR + POSE_EVENT || length == PAIR || length == POSE_EVENT;
        assert_int_equal(pose_log_read(path, &log, &why), whole ? TROCAR_OK : TROCAR_BAD_INPUT);
        if (!whole) assert_non_null(strstr(why.text, "truncated"));
        pose_log_free(&log);
    }
}

/* From a recording that is truncated or still being written, all complete events are read. */
static void reads_truncated_logs_up_to_the_last_event(void **state) {
    (void)state;
    write_log(2, -1, NULL);
    for (long length = 2 * PAIR; length > 0; length--) {
        assert_int_equal(truncate(path, length), 0);
        trocar_error why, cut;
        pose_log log;
        char place[32];
        int poses = length >= PAIR + POSE_EVENT ? 2 : length >= POSE_EVENT ? 1 : 0;
        long events = length == 2 * PAIR ? 4 : length >= PAIR + POSE_EVENT ? 3 : length >= PAIR ? 2 : length >= POSE_EVENT ? 1 : 0;
        long end = events / 2 * PAIR + events % 2 * POSE_EVENT;
        snprintf(place, sizeof place, "byte %ld: ", end);
        assert_int_equal(pose_log_read_to_cut(path, &log, &cut, &why), poses ? TROCAR_OK : TROCAR_BAD_INPUT);
        assert_int_equal(log.count, poses);
        assert_true(length == end ? *cut.text == '\0' : strstr(cut.text, place) && strstr(cut.text, "truncated"));
        pose_log_free(&log);
    }
    write_log(3, -1, NULL);
    overwrite(PAIR, "XXXX", 4); /* damaged, not truncated */
    trocar_error why, cut;
    pose_log log;
    assert_int_equal(pose_log_read_to_cut(path, &log, &cut, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "damaged"));
}

static void refuses_damage_and_names_the_place(void **state) {
    (void)state;
    char place[32];
    snprintf(place, sizeof place, "byte %d", PAIR);
    write_log(3, -1, NULL);
    overwrite(PAIR, "XXXX", 4);
    expect_bad(place, "damaged");
    write_log(3, -1, NULL);
    overwrite(PAIR + 24, "\x7f\xff\xff\xff", 4);    /* a length of 2 GiB */
    expect_bad(place, "truncated");
    write_log(3, -1, NULL);
    overwrite(PAIR + 24, "\xff\xff\xff\xf0", 4);    /* a length that is negative if read as signed */
    expect_bad(place, "truncated");
    write_log(3, -1, NULL);
    overwrite(PAIR + 20, "\0\0\0\0", 4);
    expect_bad(place, "channel name");
    write_log(3, -1, NULL);
    overwrite(28 + 11, "\1\2\3\4", 4);              /* another type's fingerprint */
    expect_bad("event 0", "not a trocar.needle_pose_t");
    write_log(3, -1, NULL);
    overwrite(0, "solid\n", 6);
    expect_bad("byte 0", "not an LCM log");
}

/* Probe poses of the wrong type or length, or with an impossible time, count as corrupt. Other probe poses that the server would refuse are counted
   separately. */
static void reads_the_probe_with_the_same_care(void **state) {
    (void)state;
    enum { PROBE_EVENT = POSE_EVENT + 28 + 12 };
    trocar_error why;
    pose_log log;
    const trocar_probe_pose_t poses[] = {{.utime = 1000500, .session = 5, .seq = 1, .orientation = {1, 0, 0, 0}},
                                         {.utime = 1000600, .session = 5, .seq = 2, .orientation = {2, 0, 0, 0}},
                                         {.utime = -1, .session = 5, .seq = 3, .orientation = {1, 0, 0, 0}}};
    for (int count = 1; count <= 3; count++) {
        lcm_eventlog_t *out = lcm_eventlog_create(path, "w");
        trocar_needle_pose_t p = sample(0);
        assert_int_equal(log_write_pose(out, &p, path, &why), TROCAR_OK);
        for (int i = 0; i < count; i++) assert_int_equal(log_write_probe(out, &poses[i], path, &why), TROCAR_OK);
        lcm_eventlog_destroy(out);
        if (count == 3) expect_bad("event 3", "impossible time of a pose of the probe");
        else assert_int_equal(pose_log_read(path, &log, &why), TROCAR_OK);
        if (count == 3) break;
        assert_int_equal(log.probe_count, 1);
        assert_int_equal(log.skipped_probes, count - 1);
        assert_int_equal(log.probes[0].next_pose, 1);
        pose_log_free(&log);
    }
    overwrite(PROBE_EVENT, "\1\2\3\4", 4);
    expect_bad("event 1", "not a trocar.probe_pose_t");
}

static void spoil_number(trocar_needle_pose_t *p) { p->position[1] = 0.0 / 0.0; }
static void spoil_quaternion(trocar_needle_pose_t *p) { p->orientation[0] = 1.01; }
static void spoil_needle(trocar_needle_pose_t *p) { p->needle = -1; }
static void spoil_time(trocar_needle_pose_t *p) { p->utime -= 1000; }
static void change_session(trocar_needle_pose_t *p) { p->session = 8; }

static void refuses_impossible_poses(void **state) {
    (void)state;
    write_log(5, 2, spoil_number);
    expect_bad("event 4", "not finite");
    write_log(5, 2, spoil_quaternion);
    expect_bad("event 4", "unit quaternion");
    write_log(5, 2, spoil_needle);
    expect_bad("event 4", "needle that no scene has");
    write_log(5, 2, spoil_time);
    expect_bad("event 4", "time does not advance");
}

static void refuses_a_log_without_poses(void **state) {
    (void)state;
    write_log(0, -1, NULL);
    expect_bad(path, "nothing on channel TROCAR_POSE");
    trocar_error why;
    pose_log log;
    assert_int_equal(pose_log_read("/nowhere/poses.log", &log, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "/nowhere/poses.log"));
    assert_int_equal(pose_log_read("/tmp", &log, &why), TROCAR_BAD_INPUT);
}

static void repeat_number(trocar_needle_pose_t *p) { p->seq -= 1; }
static void change_number_and_time(trocar_needle_pose_t *p) { p->seq -= 2, p->utime -= 2000; }

/* Duplicate and late datagrams are refused, as in the server. */
static void ignores_duplicate_and_late_poses(void **state) {
    (void)state;
    void (*changes[])(trocar_needle_pose_t *) = {repeat_number, change_number_and_time};
    for (int i = 0; i < 2; i++) {
        trocar_error why;
        pose_log log;
        write_log(6, 4, changes[i]);
        assert_int_equal(pose_log_read(path, &log, &why), TROCAR_OK);
        assert_int_equal(log.count, 5);
        assert_int_equal(log.skipped_old, 1);
        assert_int_equal(log.poses[4].seq, 5);
        pose_log_free(&log);
    }
}

/* From a log of two devices, only one needle's poses are read: by default, those of the needle named in the first pose. */
static void reads_one_needle_of_several(void **state) {
    (void)state;
    trocar_error why;
    pose_log log;
    lcm_eventlog_t *out = lcm_eventlog_create(path, "w");
    for (int64_t k = 0; k < 10; k++) {
        trocar_needle_pose_t p = sample(k / 2);
        p.needle = k % 2 ? 2 : 1;
        p.session = 10 + p.needle;
        assert_int_equal(log_write_pose(out, &p, path, &why), TROCAR_OK);
    }
    lcm_eventlog_destroy(out);
    static const int wanted[] = {-1, 1, 2};
    for (int i = 0; i < 3; i++) {
        trocar_status status = wanted[i] < 0 ? pose_log_read(path, &log, &why) : pose_log_read_needle(path, wanted[i], &log, &why);
        assert_int_equal(status, TROCAR_OK);
        assert_int_equal(log.needle, i == 2 ? 2 : 1);
        assert_int_equal(log.count, 5);
        assert_int_equal(log.skipped_sessions, 5);
        for (int k = 0; k < 5; k++) assert_true(log.poses[k].session == 10 + log.needle && log.poses[k].needle == log.needle);
        pose_log_free(&log);
    }
    assert_int_equal(pose_log_read_needle(path, 0, &log, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "no pose of needle 0"));
}

/* Release messages without a `needle` field refer to needle 0. */
static void logs_without_needles_can_still_be_read(void **state) {
    (void)state;
    trocar_error why;
    pose_log poses;
    wrench_log wrenches;
    assert_int_equal(pose_log_read(SOURCE_DIR "/tests/traces/figure8.log", &poses, &why), TROCAR_OK);
    assert_true(poses.count == 1201 && poses.needle == 0);
    for (int i = 0; i < poses.count; i++) assert_int_equal(poses.poses[i].needle, 0);
    pose_log_free(&poses);
    assert_int_equal(wrench_log_read(SOURCE_DIR "/tests/traces/figure8-golden.log", &wrenches, &why), TROCAR_OK);
    assert_true(wrenches.count == 121 && wrenches.wrenches[120].needle == 0);
    assert_string_equal(wrenches.inverse, "dense");
    wrench_log_free(&wrenches);
}

static void write_command(lcm_eventlog_t *log, int what, int64_t session, int needle, int seeds) {
    trocar_error why;
    trocar_command_t m = {.session = session, .command = what, .needle = needle, .seeds = seeds};
    assert_int_equal(log_write_command(log, &m, path, &why), TROCAR_OK);
}

/* Each command is stored with the pose that follows it. Commands of other sessions, and those that do not concern seeds, are skipped. */
static void commands_for_seeds_are_read(void **state) {
    (void)state;
    trocar_error why;
    pose_log log;
    lcm_eventlog_t *out = lcm_eventlog_create(path, "w");
    write_command(out, TROCAR_COMMAND_T_DROP_SEED, 7, 0, 1); /* a command before the first pose */
    for (int64_t k = 0; k < 10; k++) {
        trocar_needle_pose_t p = sample(k);
        assert_int_equal(log_write_pose(out, &p, path, &why), TROCAR_OK);
        if (k == 4) write_command(out, TROCAR_COMMAND_T_DROP_SEED, 7, 0, 3);
        if (k == 4) write_command(out, TROCAR_COMMAND_T_DROP_SEED, 8, 0, 1);
        if (k == 4) write_command(out, TROCAR_COMMAND_T_UNDO, 7, 1, 0);
        if (k == 5) write_command(out, TROCAR_COMMAND_T_RELEASE, 7, 0, 0);
        if (k == 9) write_command(out, TROCAR_COMMAND_T_UNDO, 7, 0, 0);
        if (k == 9) write_command(out, TROCAR_COMMAND_T_CLEAR, 7, 0, 0);
    }
    lcm_eventlog_destroy(out);
    assert_int_equal(pose_log_read(path, &log, &why), TROCAR_OK);
    assert_true(log.count == 10 && log.command_count == 3 && log.skipped_commands == 3);
    assert_true(log.commands[0].next_pose == 5 && log.commands[0].command.command == TROCAR_COMMAND_T_DROP_SEED && log.commands[0].command.seeds == 3);
    assert_true(log.commands[1].next_pose == 10 && log.commands[1].command.command == TROCAR_COMMAND_T_UNDO);
    assert_true(log.commands[2].next_pose == 10 && log.commands[2].command.command == TROCAR_COMMAND_T_CLEAR);
    pose_log_free(&log);
    overwrite(28 + 14, "\1\2\3\4", 4); /* fingerprint of an older version, without seeds */
    assert_int_equal(pose_log_read(path, &log, &why), TROCAR_OK);
    assert_true(log.command_count == 3 && log.skipped_commands == 2);
    pose_log_free(&log);
    out = lcm_eventlog_create(path, "w");
    write_command(out, TROCAR_COMMAND_T_DROP_SEED, 7, 0, 1);
    lcm_eventlog_destroy(out);
    overwrite(24, "\0\0\0\20", 4);
    expect_bad("event 0", "damaged");
}

/* Reads the server's replies to all commands. The log belongs to the fuzzer's corpus, which must be regenerated when the messages change. */
static void replies_are_read(void **state) {
    (void)state;
    static const struct { int command, needle, next_pose; logged_answer answer; } EXPECTED[] = {
        {TROCAR_COMMAND_T_DROP_SEED, 0, 2, ANSWER_DONE},  {TROCAR_COMMAND_T_DROP_SEED, 0, 3, ANSWER_DONE}, {TROCAR_COMMAND_T_TAKE, 1, 3, ANSWER_REFUSED},
        {TROCAR_COMMAND_T_UNDO, 0, 4, ANSWER_DONE},       {TROCAR_COMMAND_T_UNDO, 0, 4, ANSWER_REFUSED},  {TROCAR_COMMAND_T_LEAVE, 0, 5, ANSWER_UNKNOWN}};
    trocar_error why;
    pose_log log;
    assert_int_equal(pose_log_read_all(SOURCE_DIR "/tests/fuzz/corpus/poselog/commands_with_replies.log", &log, &why), TROCAR_OK);
    assert_int_equal(log.count, 5);
    assert_int_equal(log.probe_count, 1);
    assert_int_equal(log.command_count, 6);
    for (int i = 0; i < 6; i++) {
        const logged_command *c = &log.commands[i];
        assert_int_equal(c->command.command, EXPECTED[i].command);
        assert_int_equal(c->command.needle, EXPECTED[i].needle);
        assert_int_equal(c->next_pose, EXPECTED[i].next_pose);
        assert_int_equal(c->answer, EXPECTED[i].answer);
    }
    pose_log_free(&log);
}

static void assert_same_command(const logged_command *a, const logged_command *b) {
    uint8_t bytes[2][256];
    int size = trocar_command_t_encode(bytes[0], 0, sizeof bytes[0], &a->command);
    assert_true(size > 0 && trocar_command_t_encode(bytes[1], 0, sizeof bytes[1], &b->command) == size);
    assert_memory_equal(bytes[0], bytes[1], (size_t)size);
    assert_int_equal(a->next_pose, b->next_pose);
    assert_int_equal(a->answer, b->answer);
}

/* Checks that every pose, command and probe pose comes in the same order as if the whole log were held in memory. This must hold for any file, even a
   corrupt one. */
static void compare_with_stream(const char *file, int needle, bool all) {
    trocar_error why, scan_why;
    pose_log whole, scanned;
    trocar_status status = all ? pose_log_read_all(file, &whole, &why) : pose_log_read_needle(file, needle, &whole, &why);
    assert_int_equal(pose_log_scan(file, needle, all, &scanned, &scan_why), status);
    if (status != TROCAR_OK) {
        assert_string_equal(scan_why.text, why.text);
        return;
    }
    assert_null(scanned.poses);
    assert_null(scanned.probes);
    assert_int_equal(scanned.count, whole.count);
    assert_int_equal(scanned.needle, whole.needle);
    assert_int_equal(scanned.probe_count, whole.probe_count);
    assert_int_equal(scanned.command_count, whole.command_count);
    assert_int_equal(scanned.skipped_old + scanned.skipped_sessions + scanned.skipped_probes + scanned.skipped_commands,
                     whole.skipped_old + whole.skipped_sessions + whole.skipped_probes + whole.skipped_commands);
    for (int i = 0; i < whole.command_count; i++) assert_same_command(&scanned.commands[i], &whole.commands[i]);
    assert_same_pose(&scanned.first, &whole.poses[0]);
    assert_same_pose(&scanned.last, &whole.poses[whole.count - 1]);
    pose_stream *stream;
    pose_step step;
    assert_int_equal(pose_stream_open(file, needle, all, &stream, &why), TROCAR_OK);
    for (int i = 0, probe = 0; i <= whole.count; i++) {
        assert_int_equal(pose_stream_next(stream, &step, &why), TROCAR_OK);
        assert_int_equal(step.ended, i == whole.count);
        if (!step.ended) assert_same_pose(&step.pose, &whole.poses[i]);
        for (int k = 0; k < step.probe_count; k++, probe++) {
            assert_int_equal(whole.probes[probe].next_pose, i);
            assert_same_probe_pose(&step.probes[k], &whole.probes[probe].pose);
        }
        if (i == whole.count) assert_int_equal(probe, whole.probe_count);
    }
    pose_stream_close(stream);
    pose_log_free(&whole);
    pose_log_free(&scanned);
}

static void streams_are_the_logs(void **state) {
    (void)state;
    compare_with_stream(SOURCE_DIR "/tests/fuzz/corpus/poselog/commands_with_replies.log", -1, true);
    compare_with_stream(SOURCE_DIR "/tests/fuzz/corpus/poselog/commands_with_replies.log", -1, false);
    compare_with_stream(SOURCE_DIR "/tests/traces/figure8.log", -1, false);
    compare_with_stream(SOURCE_DIR "/tests/traces/figure8.log", 1, false);
    compare_with_stream("/nowhere", -1, true);
    trocar_error why;
    srand(1);
    lcm_eventlog_t *out = lcm_eventlog_create(path, "w");
    for (int k = 0; k < 500; k++) { /* two needles and two sessions, some late poses, and probe poses and commands in between */
        trocar_needle_pose_t p = sample(k - 3 * (rand() % 20 == 0));
        trocar_probe_pose_t probe = {.utime = p.utime, .session = 9, .seq = k, .position = {0.001 * k, 0, 0}, .orientation = {1, 0, 0, 0}};
        trocar_command_t command = {.utime = p.utime, .session = 7, .seq = k, .command = TROCAR_COMMAND_T_UNDO, .needle = rand() % 2};
        p.needle = rand() % 2;
        if (k > 400 && rand() % 4 == 0) p.session = 8;
        for (int i = rand() % 4; i > 0; i--, probe.seq += 1000000) assert_int_equal(log_write_probe(out, &probe, path, &why), TROCAR_OK);
        if (rand() % 10 == 0) assert_int_equal(log_write_command(out, &command, path, &why), TROCAR_OK);
        assert_int_equal(log_write_pose(out, &p, path, &why), TROCAR_OK);
    }
    lcm_eventlog_destroy(out);
    compare_with_stream(path, -1, true);
    for (int needle = -1; needle < 3; needle++) compare_with_stream(path, needle, false);
    overwrite(20000, "damage", 6);
    compare_with_stream(path, -1, true);
}

/* If a sender reuses a command number, replies are matched in the order of its commands. */
static void replies_to_one_number_go_to_the_oldest_command(void **state) {
    (void)state;
    trocar_error why;
    pose_log log;
    lcm_eventlog_t *out = lcm_eventlog_create(path, "w");
    trocar_needle_pose_t p = sample(0);
    trocar_command_t m = {.session = 7, .command = TROCAR_COMMAND_T_DROP_SEED, .seq = 3, .seeds = 1};
    assert_int_equal(log_write_pose(out, &p, path, &why), TROCAR_OK);
    for (int i = 0; i < 3; i++) assert_int_equal(log_write_command(out, &m, path, &why), TROCAR_OK);
    for (int i = 0; i < 2; i++) assert_int_equal(log_write_reply(out, &m, i == 0, path, &why), TROCAR_OK);
    m.session = 8; /* from another session */
    assert_int_equal(log_write_reply(out, &m, true, path, &why), TROCAR_OK);
    lcm_eventlog_destroy(out);
    assert_int_equal(pose_log_read(path, &log, &why), TROCAR_OK);
    assert_true(log.command_count == 3 && log.commands[0].answer == ANSWER_DONE && log.commands[1].answer == ANSWER_REFUSED);
    assert_int_equal(log.commands[2].answer, ANSWER_UNKNOWN);
    pose_log_free(&log);
}

static void distinguishes_other_types_from_damage(void **state) {
    (void)state;
    write_log(2, -1, NULL);
    overwrite(28 + 11, "\1\2\3\4\5\6\7\10", 8);
    expect_bad("event 0", "recorded with another lcmtypes/trocar.lcm");
    expect_bad("fingerprint", "0102030405060708");
    char short_data[] = {0, 0, 0, 80};              /* one number short of a pose, so the next event looks corrupt */
    write_log(1, -1, NULL);
    overwrite(24, short_data, 4);
    expect_bad("event 0", "damaged");
}

static void reads_wrenches_of_poses(void **state) {
    (void)state;
    trocar_error why;
    lcm_eventlog_t *out = lcm_eventlog_create(path, "w");
    for (int k = -1; k < 9; k++) {
        trocar_needle_wrench_t w = {.tick = k, .pose_seq = k, .raw_force = {0, 0, 0.1 * k}};
        assert_int_equal(log_write_wrench(out, &w, path, &why), TROCAR_OK);
    }
    lcm_eventlog_destroy(out);
    wrench_log log;
    assert_int_equal(wrench_log_read(path, &log, &why), TROCAR_OK);
    assert_int_equal(log.count, 9);
    for (int k = 0; k < 9; k++) assert_true(log.wrenches[k].pose_seq == k && log.wrenches[k].raw_force[2] == 0.1 * k);
    wrench_log_free(&log);

}

static void non_finite_wrenches_are_skipped_and_counted(void **state) {
    (void)state;
    trocar_error why;
    wrench_log log;
    lcm_eventlog_t *out = lcm_eventlog_create(path, "w");
    for (int k = 0; k < 5; k++) {
        trocar_needle_wrench_t w = {.pose_seq = k, .raw_torque = {0, k == 3 ? NAN : k, 0}};
        assert_int_equal(log_write_wrench(out, &w, path, &why), TROCAR_OK);
    }
    lcm_eventlog_destroy(out);
    assert_int_equal(wrench_log_read(path, &log, &why), TROCAR_OK);
    assert_int_equal(log.count, 4);
    assert_int_equal(log.skipped_not_finite, 1);
    assert_int_equal(log.wrenches[3].pose_seq, 4);
    wrench_log_free(&log);
}

static void status_names_the_inverse(void **state) {
    (void)state;
    trocar_error why;
    wrench_log log;
    trocar_needle_wrench_t w = {.pose_seq = 1, .server = 9};
    trocar_status_t status = {.host = "", .scene = "a.yaml", .inverse = "condensed", .message = ""};
    lcm_eventlog_t *out = lcm_eventlog_create(path, "w");
    assert_int_equal(log_write_status(out, &status, path, &why), TROCAR_OK);
    assert_int_equal(log_write_wrench(out, &w, path, &why), TROCAR_OK);
    lcm_eventlog_destroy(out);
    assert_int_equal(wrench_log_read(path, &log, &why), TROCAR_OK);
    assert_string_equal(log.inverse, "condensed");
    assert_int_equal(log.wrenches[0].server, 9);
    wrench_log_free(&log);
}

/* A log from an old release, whose wrenches do not name their server, gives the same values except that the kind of inverse is unknown. */
static void logs_without_servers_can_still_be_read(void **state) {
    (void)state;
    trocar_error why;
    wrench_log log;
    assert_int_equal(wrench_log_read(SOURCE_DIR "/tests/traces/wrenches-without-server.log", &log, &why), TROCAR_OK);
    assert_true(log.count > 100 && log.inverse[0] == '\0');
    double peak = 0;
    for (int i = 0; i < log.count; i++) {
        assert_int_equal(log.wrenches[i].server, 0);
        peak = fmax(peak, fabs(log.wrenches[i].raw_force[2]));
    }
    assert_true(peak > 1 && peak < 10);
    wrench_log_free(&log);
}

static void ignores_other_sessions(void **state) {
    (void)state;
    trocar_error why;
    pose_log log;
    write_log(5, 3, change_session);
    assert_int_equal(pose_log_read(path, &log, &why), TROCAR_OK);
    assert_int_equal(log.count, 4);
    assert_int_equal(log.skipped_sessions, 1);
    pose_log_free(&log);
}

static void poses_round_trip_through_the_message(void **state) {
    (void)state;
    pose p = {{1, 2, 3}, {0.5, -0.5, 0.5, 0.5}};
    trocar_needle_pose_t message = message_of_pose(p, 0, 0, 0);
    pose q = pose_of_message(&message);
    assert_memory_equal(&p, &q, sizeof p);
    message.orientation[0] = 0.5005;
    q = pose_of_message(&message);
    double length = q.orientation.w * q.orientation.w + 3 * q.orientation.x * q.orientation.x;
    assert_true(fabs(length - 1) < 1e-15);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(reads_what_was_written),
        cmocka_unit_test(refuses_truncated_logs),
        cmocka_unit_test(reads_truncated_logs_up_to_the_last_event),
        cmocka_unit_test(refuses_damage_and_names_the_place),
        cmocka_unit_test(reads_the_probe_with_the_same_care),
        cmocka_unit_test(refuses_impossible_poses),
        cmocka_unit_test(refuses_a_log_without_poses),
        cmocka_unit_test(ignores_duplicate_and_late_poses),
        cmocka_unit_test(reads_one_needle_of_several),
        cmocka_unit_test(logs_without_needles_can_still_be_read),
        cmocka_unit_test(commands_for_seeds_are_read),
        cmocka_unit_test(replies_are_read),
        cmocka_unit_test(streams_are_the_logs),
        cmocka_unit_test(replies_to_one_number_go_to_the_oldest_command),
        cmocka_unit_test(distinguishes_other_types_from_damage),
        cmocka_unit_test(reads_wrenches_of_poses),
        cmocka_unit_test(non_finite_wrenches_are_skipped_and_counted),
        cmocka_unit_test(status_names_the_inverse),
        cmocka_unit_test(logs_without_servers_can_still_be_read),
        cmocka_unit_test(ignores_other_sessions),
        cmocka_unit_test(poses_round_trip_through_the_message),
    };
    return cmocka_run_group_tests(tests, make_file, remove_file);
}
