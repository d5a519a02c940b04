/* The virtual coupling between hand and needle, across a network and a device. It measures the round trip, adapts the coupling's stiffness and
   damping to it, and computes the energy exchanged. If the hand oscillates nevertheless, the loop contains an unknown delay, and the coupling is
   softened until the oscillation decays. The code uses no threads and no clock: time is an argument. */
#ifndef TROCAR_VIRTUAL_COUPLING_H
#define TROCAR_VIRTUAL_COUPLING_H

#include "coupling/swing_observer.h"
#include "intake/safety_limits.h"

enum { COUPLING_TICKS = 1024 };  /* number of stored wrenches: one second at 1 kHz, which limits the round trip that can be measured */

/* A wrench that was sent to the hand. */
typedef struct {
    int64_t tick;
    int64_t computed;        /* ns, monotonic */
    vec3 force, torque;      /* force (N) and torque (N m) exerted on the hand */
} coupling_wrench;

/* Caution: a factor that allows for delays in the loop that are longer than the known ones. */
typedef struct {
    double factor;           /* the coupling is designed for the known delay times this factor; at least 1 */
    double level;            /* target of `factor`, which rises to the level at once and falls to it slowly */
    double trusted;          /* caution level before the current oscillation */
    bool own;                /* the hand kept oscillating at the highest level, so the oscillation is the hand's own */
    bool lowered;            /* the level has been lowered since it was last raised */
    double calm;             /* s since the last undamped swing */
    double loaded;           /* s under load without an undamped swing, since the level last changed */
    double patience;         /* s, value of `loaded` at which the level is lowered */
} coupling_caution;

/* State of the coupling. All zero at the start, before coupling_engage. */
typedef struct {
    coupling_wrench sent[COUPLING_TICKS];
    int64_t newest;          /* tick of the newest wrench sent */
    int64_t felt;            /* tick of the newest wrench to which a pose has referred */
    int64_t received;        /* ns, arrival of the last pose */
    pose hand;               /* the last pose */
    int64_t session;         /* session number of the hand that sent the pose */
    bool rendered;           /* true if the device renders the wrench to the hand */
    double delay;            /* s, estimated round-trip time, close to the longest of the recent ones */
    double interval;         /* s, recent mean interval between poses */
    double known;            /* s, sum of all known delays in the loop */
    double unseen;           /* s, delays that cannot be measured from the poses: the device's own delay, and a margin for unknown ones */
    coupling_caution caution;
    swing_observer swings;
    double stiffness, damping; /* current stiffness (N/m) and damping (N s/m) of the coupling; 0 if the coupling is rigid */
    vec3 stretch;            /* m, vector from the needle's base to the hand */
    vec3 before;             /* m, stretch when the last pose arrived, from which the damper's extension is counted */
    double age;              /* s, sum of the ticks' lengths since the last pose arrived */
    double energy, lowest;   /* J, net energy that the hand has put into the coupling since the engagement, and its minimum so far */
} virtual_coupling;

/* Starts the coupling at rest and with zero energy when a hand engages the needle at this pose. Until the round trip has been measured, a long delay
   is assumed. */
void coupling_engage(virtual_coupling *p, const pose_sample *hand);

/* Takes a pose; ignores a repeated one. If the pose is the first to refer to its wrench, returns the round-trip time (ns); otherwise -1. RT */
int64_t coupling_receive(virtual_coupling *p, const pose_sample *hand);

/* Returns the pose that the needle's base would have without force when the hand's end of the coupling is at `hand`; `compliance` (m/N) is the
   displacement of the base per unit force in this tick of length dt (s). The stiffness is at most limits->max_stiffness, and low enough for the loop
   to be stable at the current delay, whatever the load on the needle (docs/connect-a-device.md, "Forces and stability"). The coupling is rigid if the
   device does not render the wrench. RT */
pose coupling_hold(virtual_coupling *p, const trocar_device_limits *limits, pose hand, double dt, double *compliance);

/* Completes the tick in which the base moved to `base` (m) under the force `force` (N, exerted on the hand). Returns the torque about the hand's
   position. RT */
vec3 coupling_yield(virtual_coupling *p, pose hand, vec3 base, vec3 force, vec3 torque);

/* Stores a wrench that has been sent to the hand. RT */
void coupling_send(virtual_coupling *p, int64_t tick, int64_t now, vec3 force, vec3 torque);

/* True if the hand has received noticeably more energy than it supplied, or if the coupling has been softened because of an oscillation. RT */
bool coupling_active(const virtual_coupling *p);

#endif
