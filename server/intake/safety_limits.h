/* Protection between device and model: checks each incoming pose, and ramps and limits each outgoing wrench. The code uses no threads and no clock:
   time is an argument. */
#ifndef TROCAR_SAFETY_LIMITS_H
#define TROCAR_SAFETY_LIMITS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "base/vec.h"
#include "trocar.h"

/* The verdict on a pose. status_t has a counter for each verdict. */
typedef enum {
    POSE_ACCEPTED, POSE_MALFORMED, POSE_NO_NEEDLE, POSE_NOT_FINITE, POSE_NOT_UNIT, POSE_JUMPED, POSE_REFUSED, POSE_OLD,
    POSE_VERDICTS
} pose_verdict;

/* Returns ACCEPTED, NOT_FINITE, or NOT_UNIT if the quaternion's length differs from 1 by more than 1e-3. */
pose_verdict safety_check_pose(const pose *p);

/* Returns the shortest time (s) in which the needle can move from a to b within the device's limits. */
double safety_travel_time(const trocar_device_limits *limits, const pose *a, const pose *b);

/* The newest pose, in the form that the next tick uses. */
typedef struct {
    bool held;               /* a session owns the needle; false before the first pose and after the needle has been released */
    uint64_t engagement;     /* number of the engagement, incremented by each new owner and each reset, both of which start a new insertion; 0 before
                                the first */
    int64_t session, seq, utime, wrench_tick; /* same values as in the message */
    int64_t received;        /* ns, arrival time on this machine's monotonic clock */
    pose base;
} pose_sample;

enum { SAFETY_OVERRUNS = 20 };  /* number of consecutive late ticks that triggers the ramp */

/* State of the safety limits; all zero at the start. */
typedef struct {
    uint64_t engagement;     /* the model's current engagement; 0 if there was none yet */
    int64_t session;         /* session number of that engagement */
    pose base;               /* last pose given to the model */
    int64_t received;        /* ns, arrival time of that pose */
    bool released, stale, overrun;
    int late_ticks;          /* number of consecutive late ticks */
    double good_time;        /* s without a late tick since the ramp was triggered */
    double gain;             /* from 0 to 1, factor by which the ramp multiplies the wrench */
    vec3 force, torque;      /* force (N) and torque (N m) of the last output wrench */
    double kept;             /* from 1 to 0: fraction of the wrench before the transfer that is still in the output */
    vec3 before_force, before_torque; /* force (N) and torque (N m) of the wrench before the transfer */
} safety_limits;

typedef enum { SAFETY_IDLE, SAFETY_ENGAGE, SAFETY_FOLLOW, SAFETY_HOLD } safety_decision;

/* Decides how the model uses the newest pose at time `now` (ns): ignore it, start a new insertion at g->base, move the needle to g->base, or leave it
   where it is. After a silence, a pose that the needle could not have reached within the limits starts a new engagement. RT */
safety_decision safety_pose(safety_limits *g, const trocar_device_limits *limits, const pose_sample *newest, int64_t now);

/* Records whether this tick was late by whole periods. SAFETY_OVERRUNS consecutive late ticks trigger the ramp; a second without late ticks, or the
   next engagement, ends it. RT */
void safety_timing(safety_limits *g, bool late, double dt);

/* Starts a bumpless transfer when the model's wrench may jump for a reason other than the hand's motion. Over ramp_time, the output moves from the last
   output to the model's wrench and always lies between them. RT */
void safety_begin_transfer(safety_limits *g);

/* Ramps the model's wrench up or down, then limits its magnitude and slew rate without changing its direction; updates force and torque in place. If
   `wind_down` is true, ramps the wrench to zero regardless of the poses. Returns flags of needle_wrench_t. RT */
int safety_wrench(safety_limits *g, const trocar_device_limits *limits, bool wind_down, double dt, vec3 *force, vec3 *torque);

/* True if the wrench is zero and will remain zero until the shutdown is complete. RT */
bool safety_at_rest(const safety_limits *g);

#endif
