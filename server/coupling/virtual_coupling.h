/* The connection of hand and needle over a network and a device: measures the round trip, computes the virtual coupling for it, and the energy
   exchanged. If the hand oscillates nevertheless, there is an unknown delay: the coupling is softened until the oscillation decays. No threads, no
   clock: time is an argument. */
#ifndef TROCAR_VIRTUAL_COUPLING_H
#define TROCAR_VIRTUAL_COUPLING_H

#include "coupling/swing_observer.h"
#include "intake/safety_limits.h"

enum { COUPLING_TICKS = 1024 };  /* stored wrenches, a second at 1 kHz: the longest measurable round trip */

/* A wrench that was sent. */
typedef struct {
    int64_t tick;
    int64_t computed;        /* ns, monotonic */
    vec3 force, torque;      /* on the hand, N and N m */
} coupling_wrench;

/* Caution: how much longer than their known part the delays may be. */
typedef struct {
    double factor;           /* the coupling is designed for this many times the known delay: at least 1 */
    double level;            /* target of `factor`, which rises to it at once and falls to it slowly */
    double trusted;          /* level before the present oscillation */
    bool own;                /* the hand kept oscillating at the highest level, so it does so by itself */
    bool lowered;            /* the level has been lowered since it last rose */
    double calm;             /* s since the last swing that did not decay */
    double loaded;           /* s without such a swing in which the hand felt a force, since the level last changed */
    double patience;         /* s of `loaded` after which the level is lowered */
} coupling_caution;

/* All zero at the start, before coupling_engage. */
typedef struct {
    coupling_wrench sent[COUPLING_TICKS];
    int64_t newest;          /* tick of the newest one */
    int64_t felt;            /* newest one that a pose has named */
    int64_t received;        /* ns, arrival of the last pose */
    pose hand;               /* of that pose */
    int64_t session;         /* of the hand */
    bool rendered;           /* true: the hand feels the wrench */
    double delay;            /* s, round trip, close to the longest of the recent ones */
    double interval;         /* s, recent mean between poses */
    double known;            /* s, all known delays in the loop */
    double unseen;           /* s, delays that the poses do not show: the device's, and a margin for unknown ones */
    coupling_caution caution;
    swing_observer swings;
    double stiffness, damping; /* N/m and N s/m, present values of the coupling; 0 if it is rigid */
    vec3 stretch;            /* m, of the coupling: from the needle's base to the hand */
    vec3 before;             /* m, stretch at the arrival of the last pose, from which the damper starts */
    double age;              /* s of ticks since then */
    double energy, lowest;   /* J, from the hand into the coupling since the engagement, and its minimum */
} virtual_coupling;

/* The hand takes the needle at this pose: coupling at rest, energy zero. A long delay is assumed until it is known. */
void coupling_engage(virtual_coupling *p, const pose_sample *hand);

/* Takes a pose; a repeated one changes nothing. If the pose is the first to name its wrench, returns the round trip (ns), else -1. RT */
int64_t coupling_receive(virtual_coupling *p, const pose_sample *hand);

/* Returns the pose of the needle's base without force when the hand's end of the coupling is at `hand`; `compliance` (m/N) is its displacement per
   force in this tick of length dt (s). The stiffness is limits->max_stiffness, or less, so that the loop is stable over the delay with any load on
   the needle (docs/connect-a-device.md, "Forces and stability"). Rigid for a hand that feels no wrench. RT */
pose coupling_hold(virtual_coupling *p, const trocar_device_limits *limits, pose hand, double dt, double *compliance);

/* After the tick, with the base at `base` (m) under `force` (N, on the hand): returns the torque about the hand's point. RT */
vec3 coupling_yield(virtual_coupling *p, pose hand, vec3 base, vec3 force, vec3 torque);

/* Records a sent wrench. RT */
void coupling_send(virtual_coupling *p, int64_t tick, int64_t now, vec3 force, vec3 torque);

/* True if the hand has received more energy than it supplied, beyond a small threshold, or if the coupling is softer because it did. RT */
bool coupling_active(const virtual_coupling *p);

#endif
