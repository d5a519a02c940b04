/* Every message that comes in is judged here before it may touch anything: size, numbers, owner, order, speed. No
   network, no clock: bytes and arrival times are arguments. */
#ifndef TROCAR_POSE_ARBITER_H
#define TROCAR_POSE_ARBITER_H

#include <stddef.h>

#include "safety_limits.h"
#include "other_server.h"

/* What telemetry tells about it. */
typedef struct {
    int64_t owner;                   /* session, 0: nobody */
    int64_t received;                /* ns, monotonic: last accepted pose; 0 before the first */
    int64_t counts[POSE_VERDICTS];   /* poses by verdict, since start */
    int64_t poses_lost;              /* missing in the owner's sequence when a later one came */
    int64_t commands_refused;        /* malformed, unknown, or not from the owner */
    other_server other;              /* on the same LCM URL */
    char message[160];               /* last refusal in words */
} arbiter_record;

typedef struct {
    device_limits limits;
    arbiter_record record;
    pose_sample newest;              /* last accepted pose, or that nobody holds the needle */
    bool begin_anew;                 /* the next pose starts a new engagement */
    int64_t heard;                   /* last sequence number of the owner, accepted or not */
    double travel_credit;            /* s of motion at the limits that the time since the last poses allows */
} pose_arbiter;

void arbiter_init(pose_arbiter *in, const device_limits *limits);

/* Judges the bytes of a needle_pose_t that arrived at `now` (ns, monotonic); if ACCEPTED, `newest` is that pose.
   The first valid pose's session owns the needle until it releases it or is silent for two seconds. */
pose_verdict arbiter_pose(pose_arbiter *in, const void *data, size_t size, int64_t now);

/* Judges and obeys the bytes of a command_t. Returns true for a shutdown. */
bool arbiter_command(pose_arbiter *in, const void *data, size_t size);

#endif
