/* The virtual coupling connects hand and needle across a network and a device. It measures the round-trip time, adapts its stiffness and damping to it, and
   accounts for the energy exchanged. If the hand oscillates nevertheless, there must be an unknown delay in the loop, and the coupling is softened until the
   oscillation dies down. These functions don't touch threads or the clock: the time is passed in. */
#ifndef TROCAR_VIRTUAL_COUPLING_H
#define TROCAR_VIRTUAL_COUPLING_H

#include "coupling/swing_observer.h"
#include "intake/safety_limits.h"

enum { COUPLING_TICKS = 1024 };  /* number of wrenches to remember. One second at 1 kHz; this limits the round-trip time that can be measured */

/* A wrench that was sent to the hand. */
typedef struct {
    int64_t tick;
    int64_t computed;        /* ns, monotonic */
    vec3 force, torque;      /* on the hand: force (N) and torque (N m) */
} coupling_wrench;

/* Caution: how much longer than the known delays the loop's true delay may be. */
typedef struct {
    double factor;           /* the coupling is designed for `factor` (at least 1) times the known delay */
    double level;            /* target of `factor`, which rises to it at once and falls to it slowly */
    double trusted;          /* the level before the current oscillation */
    bool own;                /* the hand oscillates by itself: it did not stop even at the highest level */
    bool lowered;            /* the level has been lowered since it was last raised */
    double calm;             /* s since the last undamped swing */
    double loaded;           /* s under load without an undamped swing since the level last changed */
    double patience;         /* s, the level is lowered when `loaded` reaches this */
} coupling_caution;

/* State of the coupling. Zero-initialise, then call coupling_engage. */
typedef struct {
    coupling_wrench sent[COUPLING_TICKS];
    int64_t newest;          /* tick of the last wrench sent */
    int64_t felt;            /* tick of the newest wrench that a pose has responded to */
    int64_t received;        /* ns, when the last pose arrived */
    pose hand;               /* the last pose */
    int64_t session;         /* session of the hand that sent the pose */
    bool rendered;           /* the device renders the wrench to the hand */
    double delay;            /* s, estimate of the round-trip time, close to the longest recent one */
    double interval;         /* s, recent mean interval between poses */
    double known;            /* s, sum of the known delays in the loop */
    double unseen;           /* s, delays that the poses do not show: the device's own, and a margin for unknown ones */
    coupling_caution caution;
    swing_observer swings;
    double stiffness, damping; /* of the coupling at present (N/m, N s/m); 0 if it is rigid */
    vec3 stretch;            /* m, from the needle's base to the hand */
    vec3 before;             /* m, the stretch when the last pose arrived; the damper's extension is measured from here */
    double age;              /* s, tick time since the last pose arrived */
    double energy, lowest;   /* J, net energy that the hand has put into the coupling since engaging, and the minimum of it so far */
} virtual_coupling;

/* Call when a hand engages the needle. Starts the coupling at rest, with zero energy. Assumes a long delay until the round-trip time has been measured. */
void coupling_engage(virtual_coupling *p, const pose_sample *hand);

/* Takes a pose, unless it is the one taken last. Returns the round-trip time (ns) if this is the first pose to respond to its wrench; otherwise -1. RT */
int64_t coupling_receive(virtual_coupling *p, const pose_sample *hand);

/* Returns the pose the needle's base would have if no force acted on it, with the hand's end of the coupling at `hand`. Sets `compliance` (m/N) to how far the
   base moves per unit force in this tick of length dt (s). The stiffness is at most limits->max_stiffness, and low enough for the loop to be stable at the
   present delay under any load on the needle (docs/connect-a-device.md, "Forces and stability"). If the device does not render the wrench, the coupling is
   rigid. RT */
pose coupling_hold(virtual_coupling *p, const trocar_device_limits *limits, pose hand, double dt, double *compliance);

/* Completes the tick. `base`: where the base is now (m). `force`: force on the hand (N). Returns the torque about the hand's position. RT */
vec3 coupling_yield(virtual_coupling *p, pose hand, vec3 base, vec3 force, vec3 torque);

/* Remembers a wrench that has been sent to the hand. RT */
void coupling_send(virtual_coupling *p, int64_t tick, int64_t now, vec3 force, vec3 torque);

/* Returns whether the hand has received noticeably more energy than it has supplied, or the coupling has been softened because of an oscillation. RT */
bool coupling_active(const virtual_coupling *p);

#endif
