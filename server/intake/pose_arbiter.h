/* Checks every incoming message before it is used: size, numbers, owner, order, speed. A needle has one owner, and a session
   owns one needle. No network, no clock: bytes and arrival times are arguments. */
#ifndef TROCAR_POSE_ARBITER_H
#define TROCAR_POSE_ARBITER_H

#include <stddef.h>

#include "intake/requests.h"
#include "intake/other_server.h"
#include "intake/safety_limits.h"
#include "intake/sequence.h"

/* One needle's state for telemetry. */
typedef struct {
    int64_t owner;                   /* session, 0: nobody */
    int64_t received;                /* ns, monotonic: last accepted pose; 0 before the first */
    int64_t counts[POSE_VERDICTS];   /* poses by verdict, since start; MALFORMED and NO_NEEDLE are in arbiter_record */
    int64_t poses_lost;              /* missing in the owner's sequence when a later one arrived */
} needle_record;

/* The arbiter's state for telemetry. */
typedef struct {
    needle_record needles[TROCAR_MAX_NEEDLES];
    int64_t poses_malformed;         /* not a needle_pose_t */
    int64_t poses_no_needle;         /* for a needle that the scene does not have */
    int64_t commands_refused;        /* malformed, unknown, for a needle that does not exist, not from the owner, or impossible now */
    other_server other;              /* on the same LCM URL */
    char message[200];               /* text of the last refusal */
    char malformed[200];             /* text for the first malformed pose; empty: none yet */
} arbiter_record;

/* One needle's session. */
typedef struct {
    pose_sample newest;              /* last accepted pose; `held` false if nobody owns the needle */
    bool begin_anew;                 /* the next pose starts a new engagement */
    bool rests;                      /* the needle has been left: poses for it are refused */
    sequence order;                  /* of the accepted poses of newest.session, */
    sequence heard;                  /* and of all poses of the owner, accepted or not */
    double travel_credit;            /* s of motion at the limits, accumulated since the last poses */
} arbiter_needle;

typedef struct {
    trocar_device_limits limits;
    int needle_count;
    arbiter_needle needles[TROCAR_MAX_NEEDLES];
    arbiter_record record;
} pose_arbiter;

void arbiter_init(pose_arbiter *in, int needle_count, const trocar_device_limits *limits);

/* Checks the bytes of a needle_pose_t that arrived at `now` (ns, monotonic); if ACCEPTED, `newest` of its needle is that pose. The session of the
   first valid pose owns the needle until it releases it or is silent for two seconds, and can own no other needle meanwhile. */
pose_verdict arbiter_pose(pose_arbiter *in, const void *data, size_t size, int64_t now);

typedef enum {
    COMMAND_MALFORMED,   /* not a command_t of this version; no reply is possible */
    COMMAND_SETTLED,     /* done, or refused */
    COMMAND_PASS_ON,     /* the haptic thread executes or refuses it, and then calls arbiter_settle */
    COMMAND_SHUTDOWN
} command_verdict;

/* Checks the bytes of a command_t that arrived at `now` (ns, monotonic) and decodes it to `command` unless it is malformed; executes it if it
   concerns sessions alone. It is accepted from any session that might hold the needle with a pose. `distant`: sent by another machine, which may shut
   the server down only if its session owns a needle. */
command_verdict arbiter_command(pose_arbiter *in, const void *data, size_t size, bool distant, int64_t now, needle_command *command);

/* Records that the haptic thread has executed or refused a command. */
void arbiter_settle(pose_arbiter *in, const needle_command *done);

#endif
