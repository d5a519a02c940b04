/* Reads LCM event logs of poses and wrenches, with the checks that LCM's own reader lacks. */
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

/* The server's answer to a command, unknown if the log contains no reply. */
typedef enum { ANSWER_UNKNOWN, ANSWER_DONE, ANSWER_REFUSED } logged_answer;

/* A command or a change, and when it took effect: a command before the first pose after its arrival, a change before the first pose after the server's reply
   (or after its own arrival, if there is no reply). */
typedef struct {
    int next_pose;                /* index of that pose, or the number of poses if there is none */
    trocar_command_t command;     /* for a change: its sender and sequence number; the command is then TROCAR_COMMAND_T_CHANGE, and the needle 0 */
    double change_time;           /* s, how long a change takes; otherwise unused */
    char *change;                 /* lines of "key: value"; NULL if this is not a change */
    logged_answer answer;
} logged_command;

/* A pose of the ultrasound probe, and the first needle pose after it, as in logged_command. */
typedef struct {
    int next_pose;
    trocar_probe_pose_t pose;
} logged_probe;

/* The poses in a log that the server would accept, in order. Unless read by pose_log_read_all, they are all from one session and therefore of one needle. */
typedef struct {
    int needle;
    int most_needle;              /* in any pose or command */
    int count;
    trocar_needle_pose_t first, last;
    trocar_needle_pose_t *poses;  /* array of `count` poses; NULL if read by pose_log_scan */
    int command_count;
    /* array [command_count], in order. pose_log_read_all reads all commands; the others read all changes, but only the DROP_SEED, UNDO and CLEAR commands
       from the poses' session and needle */
    logged_command *commands;
    int probe_count;
    logged_probe *probes;         /* array [probe_count], in order: the probe poses that the server would accept; NULL if read by pose_log_scan */
    int64_t skipped_probes;       /* probe poses that the server would refuse */
    int64_t skipped_sessions;     /* poses skipped because they are of another needle, or of another session than the first pose */
    int64_t skipped_old;          /* poses skipped because they were repeated or out of order */
    int64_t skipped_commands;     /* DROP_SEED, UNDO and CLEAR commands skipped, from other senders or from before the first pose */
} pose_log;

/* The wrenches in a log that answer a pose, in order. */
typedef struct {
    int count;
    trocar_needle_wrench_t *wrenches; /* [count] */
    int64_t skipped_not_finite;   /* wrenches skipped because they are not finite; servers up to release 0.1 could send such */
    char inverse[16];             /* type of inverse named in the log's last status; empty if unknown */
} wrench_log;

/* Reads the needle poses, probe poses and commands in the log at `path`, and ignores other channels. Reads the poses of one needle only: `needle` or, if that
   is -1 or with pose_log_read, the needle of the first pose. Messages from older releases, which name no needle or server, count as needle 0 and server 0.
   Returns BAD_INPUT, with the file and the event or byte, if the log is missing, damaged, truncated, empty or of other message types, or if a pose is not
   finite, has no unit quaternion (safety_check_pose) or is not later than the one before. */
trocar_status pose_log_read(const char *path, pose_log *log, trocar_error *why);
trocar_status pose_log_read_needle(const char *path, int needle, pose_log *log, trocar_error *why);

/* Reads the poses of all needles in the order of the log, with the commands between them. */
trocar_status pose_log_read_all(const char *path, pose_log *log, trocar_error *why);

/* Like pose_log_read, but for a recording that is truncated or still being written: reads the events that are complete. If the log ends within an event, says
   in `cut` where; otherwise, `cut` is empty. */
trocar_status pose_log_read_to_cut(const char *path, pose_log *log, trocar_error *cut, trocar_error *why);
void pose_log_free(pose_log *log);

/* For logs that do not fit into memory. pose_log_scan reads a log as pose_log_read_needle does (or pose_log_read_all, if `all` is true), but keeps only the
   commands. A pose_stream then reads the log again, pose by pose. */
trocar_status pose_log_scan(const char *path, int needle, bool all, pose_log *log, trocar_error *why);

typedef struct pose_stream pose_stream;

/* One step through a log: the next needle pose, and the probe poses before it. */
typedef struct {
    bool ended;                   /* true if there are no more poses */
    trocar_needle_pose_t pose;
    int probe_count;              /* probe poses between the previous needle pose (or the beginning) and this one (or the end) */
    const trocar_probe_pose_t *probes; /* array [probe_count], valid until the next call */
} pose_step;

trocar_status pose_stream_open(const char *path, int needle, bool all, pose_stream **stream, trocar_error *why);
trocar_status pose_stream_next(pose_stream *stream, pose_step *step, trocar_error *why);
void pose_stream_close(pose_stream *stream);

/* Reads the wrenches that answer a pose, one at a time, in the order of the log. */
typedef struct wrench_stream wrench_stream;
trocar_status wrench_stream_open(const char *path, wrench_stream **stream, trocar_error *why);
trocar_status wrench_stream_next(wrench_stream *stream, trocar_needle_wrench_t *wrench, bool *ended, trocar_error *why);
int64_t wrench_stream_skipped(const wrench_stream *stream);       /* wrenches skipped so far because they are not finite */
const char *wrench_stream_inverse(const wrench_stream *stream);   /* as in wrench_log, but as of the last wrench read */
void wrench_stream_close(wrench_stream *stream);

trocar_status wrench_log_read(const char *path, wrench_log *log, trocar_error *why);
void wrench_log_free(wrench_log *log);

/* For lockstep: when pose i was sent (s after the first pose), and how long its tick is (s). A tick lasts from the previous pose to this one; the first lasts
   one period. A gap longer than POSE_LOG_GAP counts as POSE_LOG_GAP and adds one to `gaps`. */
#define POSE_LOG_GAP 0.1     /* s */
double pose_log_time(const pose_log *log, int i);
double pose_log_interval(const pose_log *log, int i, double rate_hz, int *gaps);

/* pose_of_message returns the pose in a message, with the quaternion normalized. message_of_pose makes a message for needle 0, as from a client that renders no
   force. */
pose pose_of_message(const trocar_needle_pose_t *message);
trocar_needle_pose_t message_of_pose(pose p, int64_t utime, int64_t session, int64_t seq);

/* Returns the pose of the probe's base that a message contains. */
trocar_pose base_of_probe(const trocar_probe_pose_t *message);

/* Moves the probe to its newest pose before needle pose `i`, or to its last pose if `i` is log->count. `done` counts the probe poses handled so far. Does
   nothing if the scene has no probe. */
trocar_status pose_log_move_probe(const pose_log *log, int i, const trocar_model *model, trocar_sim *sim, int *done, trocar_error *why);

/* Each function appends one event, with the timestamp of the message (for a wrench, of its pose). Returns SYSTEM if it cannot be written. */
trocar_status log_write_command(lcm_eventlog_t *log, const trocar_command_t *command, const char *path, trocar_error *why);
trocar_status log_write_change(lcm_eventlog_t *log, const logged_command *change, const char *path, trocar_error *why);
trocar_status log_write_reply(lcm_eventlog_t *log, const trocar_command_t *command, bool done, const char *path, trocar_error *why);
trocar_status log_write_probe(lcm_eventlog_t *log, const trocar_probe_pose_t *pose, const char *path, trocar_error *why);
trocar_status log_write_pose(lcm_eventlog_t *log, const trocar_needle_pose_t *pose, const char *path, trocar_error *why);
trocar_status log_write_wrench(lcm_eventlog_t *log, const trocar_needle_wrench_t *wrench, const char *path, trocar_error *why);
trocar_status log_write_status(lcm_eventlog_t *log, const trocar_status_t *status, const char *path, trocar_error *why);

#endif
