/* The connection of hand and needle over a network and a device: measures the round trip, computes the virtual coupling that holds the
   needle's base accordingly, and the energy exchanged. If the hand oscillates nevertheless, there is a delay that it does not know: the
   coupling is softened until the oscillation dies away. No threads, no clock: time is an argument. */
#ifndef TROCAR_VIRTUAL_COUPLING_H
#define TROCAR_VIRTUAL_COUPLING_H

#include "safety_limits.h"
#include "swing_observer.h"

enum { COUPLING_TICKS = 1024 };  /* stored wrenches, a second at 1 kHz: the longest measurable round trip */

/* A wrench that was sent. */
typedef struct {
    int64_t tick;
    int64_t computed;        /* ns, monotonic */
    vec3 force, torque;      /* on the hand, N and N m */
} coupling_wrench;

/* How much longer than known the delays may be. */
typedef struct {
    double factor;           /* the coupling is made for this many times the known delay: at least 1 */
    double level;            /* where the factor goes: at once if it rises, slowly if it falls */
    double trusted;          /* level before the present oscillation */
    bool own;                /* the hand has gone on to oscillate at the highest level: it does so by itself */
    bool lowered;            /* the level has been lowered since it rose last */
    double calm;             /* s since the last swing that did not die away */
    double loaded;           /* s without such a swing in which the hand felt a force, since the level changed last */
    double patience;         /* s of that until the level is lowered */
} coupling_caution;

/* All zero at the start, before coupling_engage. */
typedef struct {
    coupling_wrench sent[COUPLING_TICKS];
    int64_t newest;          /* tick of the last one */
    int64_t felt;            /* newest one that a pose has named */
    int64_t received;        /* ns, arrival of the last pose */
    pose hand;               /* of that pose */
    int64_t session;         /* of the hand */
    bool rendered;           /* the hand feels the wrench */
    double delay;            /* s, round trip, nearly the longest of the recent ones */
    double interval;         /* s, between poses, recent mean */
    double known;            /* s, all delays in the loop as far as they are known */
    double unseen;           /* s, those that the poses do not show: of the device, and what caution adds */
    coupling_caution caution;
    swing_observer swings;
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
   per force in this tick of length dt (s). The stiffness is limits->max_stiffness, or less, so that the loop is stable over the delay
   whatever the needle meets (docs/connect-a-device.md, "Forces and stability"). Rigid for a hand that feels no wrench. RT */
pose coupling_hold(virtual_coupling *p, const trocar_device_limits *limits, pose hand, double dt, double *compliance);

/* After the tick, with the base at `base` (m) under `force` (N, on the hand): returns the torque about the hand's point. RT */
vec3 coupling_yield(virtual_coupling *p, pose hand, vec3 base, vec3 force, vec3 torque);

/* Records a sent wrench. RT */
void coupling_send(virtual_coupling *p, int64_t tick, int64_t now, vec3 force, vec3 torque);

/* Whether the hand has received more energy than it supplied, beyond a small threshold, or the coupling is softer because it did. RT */
bool coupling_active(const virtual_coupling *p);

#endif
