/* Checks each incoming message before it is used: its size, values, owner, order and speed. A needle has at most one owner, and a session can own only one
   needle. These functions don't touch the network or the clock: bytes and arrival times are passed in. */
#ifndef TROCAR_POSE_ARBITER_H
#define TROCAR_POSE_ARBITER_H

#include <stddef.h>

#include "intake/requests.h"
#include "intake/other_server.h"
#include "intake/safety_limits.h"
#include "intake/sequence.h"

/* What telemetry reports about one needle. */
typedef struct {
    int64_t owner;                   /* session of the needle's owner; 0 if there is none */
    int64_t received;                /* ns, monotonic: when the last accepted pose arrived; 0 before the first */
    int64_t counts[POSE_VERDICTS];   /* poses per verdict since the start, except for poses_malformed and poses_no_needle, which are in arbiter_record */
    int64_t poses_lost;              /* poses of the owner still missing when a later one arrived */
} needle_record;

/* What telemetry reports about the arbiter. */
typedef struct {
    needle_record needles[TROCAR_MAX_NEEDLES];
    int64_t poses_malformed;         /* messages that are not a needle_pose_t */
    int64_t poses_no_needle;         /* poses for a needle that the scene does not have */
    /* commands that were malformed, unknown, for a needle that does not exist, not from the owner, or not possible at the time */
    int64_t commands_refused;
    other_server other;              /* a second server on the same LCM URL */
    char message[200];               /* text of the last refusal */
    char malformed[200];             /* describes the first malformed pose; empty if there was none */
} arbiter_record;

/* The session that holds one needle. */
typedef struct {
    pose_sample newest;              /* the last accepted pose; `held` is false if nobody owns the needle */
    bool begin_anew;                 /* the next pose starts a new engagement */
    bool rests;                      /* the needle was left in the tissue, so poses for it are refused */
    sequence order;                  /* order of the accepted poses from newest.session */
    sequence heard;                  /* order of all poses from the owner, accepted or not */
    double travel_credit;            /* s, travel time not used at the speed limits, which is credited to poses that arrive late */
} arbiter_needle;

typedef struct {
    trocar_device_limits limits;
    int needle_count;
    arbiter_needle needles[TROCAR_MAX_NEEDLES];
    arbiter_record record;
} pose_arbiter;

void arbiter_init(pose_arbiter *in, int needle_count, const trocar_device_limits *limits);

/* Checks the bytes of a needle_pose_t that arrived at `now` (ns, monotonic). If it is ACCEPTED, the pose becomes its needle's `newest`. The session that sends
   the first valid pose owns the needle until it releases it or has been silent for two seconds, and cannot own another needle until then. */
pose_verdict arbiter_pose(pose_arbiter *in, const void *data, size_t size, int64_t now);

typedef enum {
    COMMAND_MALFORMED,   /* not a command_t of this version, so there is nobody to reply to */
    COMMAND_SETTLED,     /* the command has been carried out or refused */
    COMMAND_PASS_ON,     /* the haptic thread must carry out or refuse the command, after which the IO thread calls arbiter_settle */
    COMMAND_SHUTDOWN
} command_verdict;

/* Checks the bytes of a command_t that arrived at `now` (ns, monotonic) and decodes them to `command`, unless they are malformed. Commands that only concern
   sessions are carried out here. A session may give a command to a needle if its poses for that needle would be accepted. `distant`: the command came from
   another machine, which may shut the server down only if its session owns a needle. */
command_verdict arbiter_command(pose_arbiter *in, const void *data, size_t size, bool distant, int64_t now, needle_command *command);

/* Counts a refused command that is not for a needle, and keeps the reason. */
void arbiter_refuse(pose_arbiter *in, const char *reason);

/* Records that the haptic thread has carried out or refused a command. */
void arbiter_settle(pose_arbiter *in, const needle_command *done);

#endif
