/* The virtual coupling between hand and needle, over a network and a device: measures the round trip, computes the coupling's stiffness and
   damping for it, and the energy exchanged. If the hand oscillates nevertheless, the loop has an unknown delay, and the coupling is softened until
   the oscillation decays. No threads, no clock: time is an argument. */
#ifndef TROCAR_VIRTUAL_COUPLING_H
#define TROCAR_VIRTUAL_COUPLING_H

#include "coupling/swing_observer.h"
#include "intake/safety_limits.h"

enum { COUPLING_TICKS = 1024 };  /* number of stored wrenches: one second at 1 kHz, which is the longest round trip that can be measured */

/* A wrench that was sent to the hand. */
typedef struct {
    int64_t tick;
    int64_t computed;        /* ns, monotonic */
    vec3 force, torque;      /* exerted on the hand, N and N m */
} coupling_wrench;

/* Caution: the factor by which the loop's delays may exceed the known ones. */
typedef struct {
    double factor;           /* the coupling is designed for this multiple of the known delay; at least 1 */
    double level;            /* target of `factor`, which rises to it at once and falls to it slowly */
    double trusted;          /* level before the present oscillation */
    bool own;                /* the hand kept oscillating at the highest level, so the coupling is not the cause */
    bool lowered;            /* the level has been lowered since it last rose */
    double calm;             /* s since the last swing that did not decay */
    double loaded;           /* s in which the hand felt a force and no such swing occurred, since the level last changed */
    double patience;         /* value of `loaded`, s, at which the level is lowered */
} coupling_caution;

/* State of the coupling. All zero at the start, before coupling_engage. */
typedef struct {
    coupling_wrench sent[COUPLING_TICKS];
    int64_t newest;          /* tick of the newest wrench */
    int64_t felt;            /* tick of the newest wrench that a pose has named */
    int64_t received;        /* ns, arrival of the last pose */
    pose hand;               /* the last pose */
    int64_t session;         /* session of the hand that sent it */
    bool rendered;           /* the hand feels the wrench */
    double delay;            /* s, estimate of the round trip, close to the longest of the recent ones */
    double interval;         /* s, recent mean interval between poses */
    double known;            /* s, sum of all known delays in the loop */
    double unseen;           /* s, delays that the poses do not show: the device's own, and a margin for unknown delays */
    coupling_caution caution;
    swing_observer swings;
    double stiffness, damping; /* N/m and N s/m, present values of the coupling; 0 if it is rigid */
    vec3 stretch;            /* m, from the needle's base to the hand */
    vec3 before;             /* m, stretch at the arrival of the last pose, from which the damper starts */
    double age;              /* s of ticks since that arrival */
    double energy, lowest;   /* J, from the hand into the coupling since the engagement, and its minimum */
} virtual_coupling;

/* Starts the coupling at rest and with zero energy when a hand engages the needle at this pose. A long delay is assumed until the round trip has been
   measured. */
void coupling_engage(virtual_coupling *p, const pose_sample *hand);

/* Takes a pose; a repeated pose changes nothing. If the pose is the first one that names its wrench, returns the round trip (ns), else -1. RT */
int64_t coupling_receive(virtual_coupling *p, const pose_sample *hand);

/* Returns the pose of the needle's base without force when the hand's end of the coupling is at `hand`; `compliance` (m/N) is the base's
   displacement per unit force in this tick of length dt (s). The stiffness is at most limits->max_stiffness, and low enough that the loop is
   stable over the delay with any load on the needle (docs/connect-a-device.md, "Forces and stability"). The coupling is rigid for a hand that
   feels no wrench. RT */
pose coupling_hold(virtual_coupling *p, const trocar_device_limits *limits, pose hand, double dt, double *compliance);

/* Completes the tick, in which the base moved to `base` (m) under `force` (N, on the hand). Returns the torque about the hand's position. RT */
vec3 coupling_yield(virtual_coupling *p, pose hand, vec3 base, vec3 force, vec3 torque);

/* Stores a wrench that was sent. RT */
void coupling_send(virtual_coupling *p, int64_t tick, int64_t now, vec3 force, vec3 torque);

/* True if the hand has received more energy than it supplied, beyond a small threshold, or if the coupling has been softened for that reason. RT */
bool coupling_active(const virtual_coupling *p);

#endif
