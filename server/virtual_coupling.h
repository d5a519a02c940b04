/* The connection of hand and needle over a network: measures the round trip, computes the virtual coupling that holds the needle's
   base accordingly, and the energy exchanged. No threads, no clock: time is an argument. */
#ifndef TROCAR_VIRTUAL_COUPLING_H
#define TROCAR_VIRTUAL_COUPLING_H

#include "safety_limits.h"

enum { COUPLING_TICKS = 1024 };  /* stored wrenches, a second at 1 kHz: the longest measurable round trip */

/* A wrench that was sent. */
typedef struct {
    int64_t tick;
    int64_t computed;        /* ns, monotonic */
    vec3 force, torque;      /* on the hand, N and N m */
} coupling_wrench;

/* All zero at the start, before coupling_engage. */
typedef struct {
    coupling_wrench sent[COUPLING_TICKS];
    int64_t newest;          /* tick of the last one */
    int64_t felt;            /* newest one that a pose has named */
    int64_t received;        /* ns, arrival of the last pose */
    pose hand;               /* of that pose */
    double delay;            /* s, round trip, nearly the longest of the recent ones */
    double interval;         /* s, between poses, recent mean */
    double stiffness, damping; /* N/m and N s/m, of the coupling now; 0 when it is rigid */
    vec3 stretch;            /* m, of the coupling: from the needle's base to the hand */
    vec3 before;             /* m, stretch at the arrival of the last pose, from which the damper starts */
    double age;              /* s of ticks since then */
    double energy, lowest;   /* J, from the hand into the coupling since the engagement, and its minimum */
} virtual_coupling;

/* The hand takes the needle at this pose: coupling at rest, energy zero; the delay is assumed to be long until it is known. */
void coupling_engage(virtual_coupling *p, const pose_sample *hand);

/* Takes a pose; a repeated one changes nothing. Returns the round trip (ns) of the wrench that it is the first to name, or -1. RT
   */
int64_t coupling_receive(virtual_coupling *p, const pose_sample *hand);

/* Pose of the needle's base without force, when the hand's end of the coupling is at `hand`; `compliance` (m/N) is its displacement
   per force in this tick of length dt (s). The stiffness is `limit` (N/m), or less, so that the loop is stable over the delay
   whatever the needle meets (docs/connect-a-device.md, "Forces and stability"). RT */
pose coupling_hold(virtual_coupling *p, double limit, pose hand, double dt, double *compliance);

/* After the tick, with the base at `base` (m) under `force` (N, on the hand): returns the torque about the hand's point. RT */
vec3 coupling_yield(virtual_coupling *p, pose hand, vec3 base, vec3 force, vec3 torque);

/* Records a sent wrench. RT */
void coupling_send(virtual_coupling *p, int64_t tick, int64_t now, vec3 force, vec3 torque);

/* Whether the hand has received more energy than it supplied, beyond a small threshold. RT */
bool coupling_active(const virtual_coupling *p);

#endif
