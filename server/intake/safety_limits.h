/* Protects device and model from each other: checks incoming poses, and ramps and limits outgoing wrenches. These functions don't touch threads or the clock:
   the time is passed in. */
#ifndef TROCAR_SAFETY_LIMITS_H
#define TROCAR_SAFETY_LIMITS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "base/vec.h"
#include "trocar.h"

/* The verdict on a pose. status_t counts the poses with each verdict. */
typedef enum {
    POSE_ACCEPTED, POSE_MALFORMED, POSE_NO_NEEDLE, POSE_NOT_FINITE, POSE_NOT_UNIT, POSE_JUMPED, POSE_REFUSED, POSE_OLD,
    POSE_VERDICTS
} pose_verdict;

/* Returns ACCEPTED, NOT_FINITE, or NOT_UNIT if the quaternion's length differs from 1 by more than 1e-3. */
pose_verdict safety_check_pose(const pose *p);

/* Returns the shortest time (s) in which the needle can move from a to b within the device's limits. */
double safety_travel_time(const trocar_device_limits *limits, const pose *a, const pose *b);

/* The newest pose, as used by the next tick. */
typedef struct {
    bool held;               /* a session owns the needle; false before the first pose and after a release */
    uint64_t engagement;     /* counts engagements. Each new owner and each reset starts one, and with it a new insertion; 0 before the first */
    int64_t session, seq, utime, wrench_tick; /* as in the message */
    int64_t received;        /* ns, arrival on this machine's monotonic clock */
    pose base;
} pose_sample;

enum { SAFETY_OVERRUNS = 20 };  /* this many late ticks in a row trigger the ramp */

/* State of the safety limits. Zero-initialise. */
typedef struct {
    uint64_t engagement;     /* the model's current engagement; 0 before the first */
    int64_t session;         /* session number of that engagement */
    pose base;               /* last pose passed to the model */
    int64_t received;        /* ns, when that pose arrived */
    bool released, stale, overrun;
    int late_ticks;          /* number of consecutive late ticks */
    double good_time;        /* s without a late tick since the ramp was triggered */
    double gain;             /* from 0 to 1, the ramp multiplies the wrench by this */
    vec3 force, torque;      /* the last output wrench: force (N) and torque (N m) */
    double kept;             /* from 1 to 0, how much of the wrench before the transfer is still in the output */
    vec3 before_force, before_torque; /* the wrench before the transfer: force (N) and torque (N m) */
} safety_limits;

typedef enum { SAFETY_IDLE, SAFETY_ENGAGE, SAFETY_FOLLOW, SAFETY_HOLD } safety_decision;

/* Decides what the model does with the newest pose at time `now` (ns): ignore it, start a new insertion at g->base, move the needle to g->base, or leave the
   needle where it is. After a silence, a pose that the needle could not have reached within the limits starts a new engagement. RT */
safety_decision safety_pose(safety_limits *g, const trocar_device_limits *limits, const pose_sample *newest, int64_t now);

/* Records whether whole periods were missed before this tick. SAFETY_OVERRUNS late ticks in a row trigger the ramp, which ends after a second without late
   ticks, or with the next engagement. RT */
void safety_timing(safety_limits *g, bool late, double dt);

/* Starts a bumpless transfer. Call this when the model's wrench may jump for any reason other than the hand's motion. Over ramp_time, the output goes from
   where it was to the model's wrench, and always lies between the two. RT */
void safety_begin_transfer(safety_limits *g);

/* Ramps the model's wrench up or down, then limits its magnitude and slew rate without changing its direction. Updates force and torque in place. `wind_down`:
   ramp to zero whatever the poses. Returns flags of needle_wrench_t. RT */
int safety_wrench(safety_limits *g, const trocar_device_limits *limits, bool wind_down, double dt, vec3 *force, vec3 *torque);

/* Returns whether the wrench is zero and will stay zero until shutdown is complete. RT */
bool safety_at_rest(const safety_limits *g);

#endif
