/* Checks the size, values, owner, order and speed of every incoming message before the message is used. A needle has at most one owner, and a session
   can own only one needle. The code uses no network and no clock: bytes and arrival times are arguments. */
#ifndef TROCAR_POSE_ARBITER_H
#define TROCAR_POSE_ARBITER_H

#include <stddef.h>

#include "intake/requests.h"
#include "intake/other_server.h"
#include "intake/safety_limits.h"
#include "intake/sequence.h"

/* One needle's state for telemetry. */
typedef struct {
    int64_t owner;                   /* session number of the needle's owner; 0 if there is none */
    int64_t received;                /* ns, monotonic: arrival time of the last accepted pose; 0 before the first */
    int64_t counts[POSE_VERDICTS];   /* number of poses per verdict since the start; poses_malformed and poses_no_needle are counted in arbiter_record */
    int64_t poses_lost;              /* number of the owner's poses that were still missing when a later one arrived */
} needle_record;

/* The arbiter's state for telemetry. */
typedef struct {
    needle_record needles[TROCAR_MAX_NEEDLES];
    int64_t poses_malformed;         /* number of received messages that are not a needle_pose_t */
    int64_t poses_no_needle;         /* number of poses for a needle that does not exist in the scene */
    /* number of commands refused because they are malformed, unknown, for a needle that does not exist, not from the owner, or impossible at the
       time */
    int64_t commands_refused;
    other_server other;              /* state of a second server on the same LCM URL */
    char message[200];               /* text of the last refusal */
    char malformed[200];             /* message about the first malformed pose; empty if there was none */
} arbiter_record;

/* State of the session that holds one needle. */
typedef struct {
    pose_sample newest;              /* last accepted pose; `held` is false if nobody owns the needle */
    bool begin_anew;                 /* the next pose starts a new engagement */
    bool rests;                      /* the needle has been left in the tissue, so poses for it are refused */
    sequence order;                  /* sequence state of the accepted poses from newest.session */
    sequence heard;                  /* sequence state of all poses from the owner, accepted or not */
    double travel_credit;            /* s, unused travel time at the speed limits, credited to poses that arrive late */
} arbiter_needle;

typedef struct {
    trocar_device_limits limits;
    int needle_count;
    arbiter_needle needles[TROCAR_MAX_NEEDLES];
    arbiter_record record;
} pose_arbiter;

void arbiter_init(pose_arbiter *in, int needle_count, const trocar_device_limits *limits);

/* Checks the bytes of a needle_pose_t that arrived at `now` (ns, monotonic). If the verdict is ACCEPTED, the pose becomes the `newest` of its
   needle. The session of the first valid pose owns the needle until it releases the needle or is silent for two seconds; until then it cannot own
   another needle. */
pose_verdict arbiter_pose(pose_arbiter *in, const void *data, size_t size, int64_t now);

typedef enum {
    COMMAND_MALFORMED,   /* the bytes are not a command_t of this version, so no reply is possible */
    COMMAND_SETTLED,     /* the command has been executed or refused */
    COMMAND_PASS_ON,     /* the haptic thread must execute or refuse the command; the IO thread then calls arbiter_settle */
    COMMAND_SHUTDOWN
} command_verdict;

/* Checks the bytes of a command_t that arrived at `now` (ns, monotonic) and, unless they are malformed, decodes them to `command`; if the command
   only concerns sessions, also executes it. A command is accepted from any session whose pose for the needle would be accepted. If `distant` is true,
   the command came from another machine, which may shut down the server only if its session owns a needle. */
command_verdict arbiter_command(pose_arbiter *in, const void *data, size_t size, bool distant, int64_t now, needle_command *command);

/* Counts a refused command that is not for a needle, and records the reason. */
void arbiter_refuse(pose_arbiter *in, const char *reason);

/* Records that the haptic thread has executed or refused a command. */
void arbiter_settle(pose_arbiter *in, const needle_command *done);

#endif
