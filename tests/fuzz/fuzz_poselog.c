/* Reads a log of poses. Either it is refused with the file's name in the message, or its poses are finite, belong to one session and are in chronological
   order, and its commands are in the order of the poses. The same bytes are also read as a log of golden wrenches: either they are refused in the same way,
   or every wrench answers a pose. */
#include "fuzz.h"

#include <math.h>
#include <string.h>

#include "intake/safety_limits.h"
#include "shared/poselog.h"

static void read_wrenches(const char *path) {
    wrench_log log;
    trocar_error why = {""};
    if (wrench_log_read(path, &log, &why) != TROCAR_OK) {
        REQUIRE(strncmp(why.text, path, strlen(path)) == 0);
        REQUIRE(log.count == 0 && log.wrenches == NULL);
        return;
    }
    for (int i = 0; i < log.count; i++) REQUIRE(log.wrenches[i].pose_seq >= 0);
    wrench_log_free(&log);
}

static void check_commands(const pose_log *log) {
    for (int i = 0; i < log->command_count; i++) {
        const logged_command *c = &log->commands[i];
        REQUIRE(c->next_pose >= (i == 0 ? 0 : log->commands[i - 1].next_pose) && c->next_pose <= log->count);
        REQUIRE(c->answer == ANSWER_UNKNOWN || c->answer == ANSWER_DONE || c->answer == ANSWER_REFUSED);
    }
}

/* Also reads the log one pose at a time. */
static void read_stream(const char *path, const pose_log *log) {
    pose_stream *stream;
    pose_step step;
    trocar_error why;
    REQUIRE(pose_stream_open(path, -1, false, &stream, &why) == TROCAR_OK);
    for (int i = 0; i <= log->count; i++) {
        REQUIRE(pose_stream_next(stream, &step, &why) == TROCAR_OK);
        REQUIRE(step.ended == (i == log->count));
        REQUIRE(step.ended || memcmp(&step.pose, &log->poses[i], sizeof step.pose) == 0);
    }
    pose_stream_close(stream);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pose_log log;
    trocar_error why = {""};
    const char *path = file_of(data, size);
    read_wrenches(path);
    if (pose_log_read_all(path, &log, &why) == TROCAR_OK) {
        check_commands(&log);
        pose_log_free(&log);
    }
    if (pose_log_read(path, &log, &why) != TROCAR_OK) {
        REQUIRE(strncmp(why.text, path, strlen(path)) == 0);
        REQUIRE(log.count == 0 && log.poses == NULL);
        return 0;
    }
    check_commands(&log);
    read_stream(path, &log);
    for (int i = 0; i < log.count; i++) {
        pose p = pose_of_message(&log.poses[i]);
        REQUIRE(safety_check_pose(&p) == POSE_ACCEPTED);
        REQUIRE(i == 0 || (log.poses[i].session == log.poses[0].session && log.poses[i].utime > log.poses[i - 1].utime));
    }
    pose_log_free(&log);
    return 0;
}
