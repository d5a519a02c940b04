/* The closed loop of hand, device, bridge, network and server, in one process on a simulated clock. It uses the server's own tick (haptic.h), a bridge that
   works like trocar-haply, and a simulated device. */
#ifndef TROCAR_TESTS_CLOSED_LOOP_H
#define TROCAR_TESTS_CLOSED_LOOP_H

#include "haptic.h"
#include "limiter.h"
#include "passivity.h"
#include "simulated_device.h"
#include "trocar_needle_wrench_t.h"

enum { LOOP_FLIGHT = 128 };    /* most messages in transit at once */

typedef struct {
    double period, sampling; /* s; period: of the server's tick; sampling: between two messages of the bridge */
    double network;          /* s, one-way delay between bridge and server */
    double max_force, max_force_rate; /* N and N/s, the bridge's limits */
    double scale, force_scale; /* motion of the needle per motion of the hand, and force on the hand per force on the needle */
    bool names_wrenches;     /* whether the bridge reports which wrench it renders */
} loop_properties;

typedef struct {
    trocar_model *model;
    trocar_sim *sim;
    exchange exchange;
    haptic haptic;
    loop_properties properties;
    simulated_device device;
    vec3 start;              /* m, where needle and hand coincide */
    limiter limiter;
    passivity passivity;     /* the bridge's controller, active if it has a period */
    int64_t now, next_tick, next_message; /* ns */
    int64_t tick, seq;
    pose_sample poses[LOOP_FLIGHT];          /* poses sent, indexed by seq modulo LOOP_FLIGHT */
    struct { int64_t arrival; trocar_needle_wrench_t wrench; } wrenches[LOOP_FLIGHT]; /* wrenches sent, indexed by tick modulo LOOP_FLIGHT */
    int64_t felt;            /* tick of the wrench that the bridge renders, -1 before the first */
    trocar_needle_wrench_t newest; /* of the last tick */
    int flags;               /* set in any wrench since rig_watch */
    double greatest_force;   /* N, since then */
    vec3 lowest_base, highest_base; /* m, range of the base positions received by the server since rig_watch */
} closed_loop;

/* Creates a simulation of `model` at `period`, and a device that rests at `start` with the needle along z. Aborts on failure. */
closed_loop *rig_create(trocar_model *model, const trocar_device_limits *limits, const loop_properties *properties, const device_properties *device,
                         vec3 start);
void rig_free(closed_loop *l);

/* Runs for this time (s). */
void rig_run(closed_loop *l, double seconds);

/* Returns the seconds since the start. */
double rig_time(const closed_loop *l);

/* Resets the flags, the largest force and the device's extreme positions. */
void rig_watch(closed_loop *l);

#endif
