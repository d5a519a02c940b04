/* Reads LCM event logs of poses and wrenches, with checks that LCM's own reader lacks. */
#ifndef TROCAR_POSELOG_H
#define TROCAR_POSELOG_H

#include <stdbool.h>

#include <lcm/lcm.h>

#include "base/error.h"
#include "base/vec.h"
#include "trocar.h"
#include "trocar_change_t.h"
#include "trocar_command_t.h"
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"
#include "trocar_probe_pose_t.h"
#include "trocar_status_t.h"

#define POSE_CHANNEL "TROCAR_POSE"
#define WRENCH_CHANNEL "TROCAR_WRENCH"
#define STATUS_CHANNEL "TROCAR_STATUS"
#define COMMAND_CHANNEL "TROCAR_COMMAND"
#define REPLY_CHANNEL "TROCAR_REPLY"
#define CHANGE_CHANNEL "TROCAR_CHANGE"
#define PROBE_CHANNEL "TROCAR_PROBE"

/* The server's answer to a command; unknown if the log contains no reply to it. */
typedef enum { ANSWER_UNKNOWN, ANSWER_DONE, ANSWER_REFUSED } logged_answer;

/* A command, with the first pose after its arrival; or a change, with the first pose after the server's reply (or after its arrival, if there is no reply). */
typedef struct {
    int next_pose;                /* index of that pose; the number of poses if there is none */
    trocar_command_t command;     /* for a change: its sender and sequence number, with TROCAR_COMMAND_T_CHANGE as the command, and needle 0 */
    double change_time;           /* s, duration of a change; otherwise unused */
    char *change;                 /* lines of "key: value"; NULL if this is not a change */
    logged_answer answer;
} logged_command;

/* A pose of the ultrasound probe, with the first needle pose after its arrival, as in logged_command. */
typedef struct {
    int next_pose;
    trocar_probe_pose_t pose;
} logged_probe;

/* The poses in a log that the server would accept, in order. Unless read by pose_log_read_all, all are from one session and therefore of one needle. */
typedef struct {
    int needle;
    int most_needle;              /* largest needle index in any pose or command */
    int count;
    trocar_needle_pose_t first, last;
    trocar_needle_pose_t *poses;  /* array of `count` poses; NULL if read by pose_log_scan */
    int command_count;
    /* array [command_count], in order: all commands if read by pose_log_read_all, otherwise only DROP_SEED and UNDO from the poses' session and
       needle, and all changes */
    logged_command *commands;
    int probe_count;
    logged_probe *probes;         /* array [probe_count], in order: the poses of the probe that the server would accept; NULL if read by pose_log_scan */
    int64_t skipped_probes;       /* number of poses of the probe that the server would refuse */
    int64_t skipped_sessions;     /* number of skipped poses that belong to other needles, or to sessions other than that of the first pose */
    int64_t skipped_old;          /* number of skipped poses that were repeated or out of order */
    int64_t skipped_commands;     /* number of skipped DROP_SEED and UNDO commands from other senders, or from before the first pose */
} pose_log;

/* The wrenches of a log that answer a pose, in the order of the log. */
typedef struct {
    int count;
    trocar_needle_wrench_t *wrenches; /* [count] */
    int64_t skipped_not_finite;   /* number of skipped wrenches that are not finite, which servers up to release 0.1 could send */
    char inverse[16];             /* type of inverse according to the log's last status; empty if unknown */
} wrench_log;

/* Reads the needle poses, probe poses and commands of the log at `path`; other channels are ignored. Only the poses of one needle are
   read: of `needle`, or of the first pose's needle if `needle` is -1, as in pose_log_read. BAD_INPUT, with file and event or byte, for a log that is missing,
   damaged, truncated, empty or of other message types, and for a pose that is not finite, has no unit quaternion (safety_check_pose) or is not later than the
   previous one. Messages of older releases, which do not name their needle or server, are attributed to needle 0 and server 0. */
trocar_status pose_log_read(const char *path, pose_log *log, trocar_error *why);
trocar_status pose_log_read_needle(const char *path, int needle, pose_log *log, trocar_error *why);

/* Reads the poses of all needles in the order of the log, and the commands between them. */
trocar_status pose_log_read_all(const char *path, pose_log *log, trocar_error *why);

/* Like pose_log_read, for a recording that is truncated or still being written: reads its complete events. If the log ends within an event, `cut`
   states where; otherwise, `cut` is empty. */
trocar_status pose_log_read_to_cut(const char *path, pose_log *log, trocar_error *cut, trocar_error *why);
void pose_log_free(pose_log *log);

/* For logs too long for memory. pose_log_scan reads a log in the same way as pose_log_read_needle or, if `all` is true, as pose_log_read_all, but keeps
   only the commands. A pose_stream then reads the log again, pose by pose. */
trocar_status pose_log_scan(const char *path, int needle, bool all, pose_log *log, trocar_error *why);

typedef struct pose_stream pose_stream;

/* One step through a log: the next needle pose, and the probe poses before it. */
typedef struct {
    bool ended;                   /* true if the log has no further pose */
    trocar_needle_pose_t pose;
    int probe_count;              /* number of probe poses between the previous needle pose (or the beginning) and this one (or the end) */
    const trocar_probe_pose_t *probes; /* array [probe_count], valid until the next call */
} pose_step;

trocar_status pose_stream_open(const char *path, int needle, bool all, pose_stream **stream, trocar_error *why);
trocar_status pose_stream_next(pose_stream *stream, pose_step *step, trocar_error *why);
void pose_stream_close(pose_stream *stream);

/* Reads the wrenches that answer a pose, one at a time, in the order of the log. */
typedef struct wrench_stream wrench_stream;
trocar_status wrench_stream_open(const char *path, wrench_stream **stream, trocar_error *why);
trocar_status wrench_stream_next(wrench_stream *stream, trocar_needle_wrench_t *wrench, bool *ended, trocar_error *why);
int64_t wrench_stream_skipped(const wrench_stream *stream);       /* number of wrenches skipped so far because they are not finite */
const char *wrench_stream_inverse(const wrench_stream *stream);   /* type of inverse as in wrench_log, according to the last wrench read so far */
void wrench_stream_close(wrench_stream *stream);

trocar_status wrench_log_read(const char *path, wrench_log *log, trocar_error *why);
void wrench_log_free(wrench_log *log);

/* For lockstep: the time of pose i (s after the first pose), and the length of its tick (s), which is the time since the previous pose, or
   one period for the first pose. A gap longer than POSE_LOG_GAP counts as POSE_LOG_GAP and adds one to `gaps`. */
#define POSE_LOG_GAP 0.1     /* s */
double pose_log_time(const pose_log *log, int i);
double pose_log_interval(const pose_log *log, int i, double rate_hz, int *gaps);

/* pose_of_message returns the pose in a message, with a normalised quaternion. message_of_pose returns the message for a pose of needle 0 from a client that
   renders no force. */
pose pose_of_message(const trocar_needle_pose_t *message);
trocar_needle_pose_t message_of_pose(pose p, int64_t utime, int64_t session, int64_t seq);

/* Returns the pose of the probe's base in a message. */
trocar_pose base_of_probe(const trocar_probe_pose_t *message);

/* Moves the probe to its newest pose before needle pose `i` (if `i` is log->count, to its last pose). `done` is the number of probe poses handled so
   far. Does nothing if the scene has no probe. */
trocar_status pose_log_move_probe(const pose_log *log, int i, const trocar_model *model, trocar_sim *sim, int *done, trocar_error *why);

/* Each function appends one event, whose timestamp is the message's (for a wrench, the pose's). SYSTEM if the event cannot be written. */
trocar_status log_write_command(lcm_eventlog_t *log, const trocar_command_t *command, const char *path, trocar_error *why);
trocar_status log_write_change(lcm_eventlog_t *log, const logged_command *change, const char *path, trocar_error *why);
trocar_status log_write_reply(lcm_eventlog_t *log, const trocar_command_t *command, bool done, const char *path, trocar_error *why);
trocar_status log_write_probe(lcm_eventlog_t *log, const trocar_probe_pose_t *pose, const char *path, trocar_error *why);
trocar_status log_write_pose(lcm_eventlog_t *log, const trocar_needle_pose_t *pose, const char *path, trocar_error *why);
trocar_status log_write_wrench(lcm_eventlog_t *log, const trocar_needle_wrench_t *wrench, const char *path, trocar_error *why);
trocar_status log_write_status(lcm_eventlog_t *log, const trocar_status_t *status, const char *path, trocar_error *why);

#endif
