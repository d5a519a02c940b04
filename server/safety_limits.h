/* What stands between the device and the model: checks on each pose that comes in, ramps and limits on each wrench
   that goes out. No threads, no clock: time is an argument. */
#ifndef TROCAR_SAFETY_LIMITS_H
#define TROCAR_SAFETY_LIMITS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "base/vec.h"
#include "trocar.h"

/* The verdict on one pose; each has its counter in status_t. */
typedef enum {
    POSE_ACCEPTED, POSE_MALFORMED, POSE_NO_NEEDLE, POSE_NOT_FINITE, POSE_NOT_UNIT, POSE_JUMPED, POSE_REFUSED, POSE_OLD,
    POSE_VERDICTS
} pose_verdict;

/* ACCEPTED, NOT_FINITE, or NOT_UNIT (quaternion off unit length by more than 1e-3). */
pose_verdict safety_check_pose(const pose *p);

/* Least time that a device within its limits needs from a to b, s. */
double safety_travel_time(const trocar_device_limits *limits, const pose *a, const pose *b);

/* The newest pose as it waits for the tick. */
typedef struct {
    bool held;               /* somebody owns the needle; false before the first pose and after a release */
    uint64_t engagement;     /* grows with each new owner and each reset: the insertion starts anew; 0 before the first */
    int64_t session, seq, utime, wrench_tick; /* of the message */
    int64_t received;        /* ns, monotonic clock of this machine */
    pose base;
} pose_sample;

enum { SAFETY_OVERRUNS = 20 };  /* late ticks in a row that trip the ramp */

/* State of the safety limits; all zero at the start. */
typedef struct {
    uint64_t engagement;     /* that the model runs in, 0: none yet */
    pose base;               /* last one given to the model */
    int64_t received;        /* ns, when it came */
    bool released, stale, overrun;
    int late_ticks;          /* in a row */
    double good_time;        /* s without a late tick since the trip */
    double gain;             /* 0..1 */
    vec3 force, torque;      /* last wrench given out, N and N m */
} safety_limits;

typedef enum { SAFETY_IDLE, SAFETY_ENGAGE, SAFETY_FOLLOW, SAFETY_HOLD } safety_decision;

/* Decides what the model does with the newest pose at time `now` (ns): nothing yet, begin anew at g->base, follow to
   g->base, or stay there. A pose that returns after a silence from further away than the limits allow engages anew. RT */
safety_decision safety_pose(safety_limits *g, const trocar_device_limits *limits, const pose_sample *newest, int64_t now);

/* Notes whether this tick came late by whole periods; trips after SAFETY_OVERRUNS in a row, recovers after a second
   of good timing or at the next engagement. RT */
void safety_timing(safety_limits *g, bool late, double dt);

/* Ramps the model's wrench in or out, then limits magnitude and slew without turning it; updates both in place.
   `wind_down` ramps to zero whatever the poses are. Returns flags of needle_wrench_t. RT */
int safety_wrench(safety_limits *g, const trocar_device_limits *limits, bool wind_down, double dt, vec3 *force, vec3 *torque);

/* No wrench is left and none will follow while it winds down. RT */
bool safety_at_rest(const safety_limits *g);

#endif
