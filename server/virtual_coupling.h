/* The port where hand and needle meet, with a network in between: how far away the hand is, the virtual coupling that holds
   the needle's base accordingly, and the energy that crosses. No threads, no clock: time is an argument. */
#ifndef TROCAR_VIRTUAL_COUPLING_H
#define TROCAR_VIRTUAL_COUPLING_H

#include "safety_limits.h"

enum { COUPLING_TICKS = 1024 };  /* wrenches remembered, a second at 1 kHz: the longest round trip that is measured */

/* A wrench that has gone out. */
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
    int64_t received;        /* ns, when the last pose came */
    pose hand;               /* in that pose */
    double delay;            /* s, round trip, nearly the longest of late */
    double interval;         /* s, between poses, mean of late */
    double stiffness, damping; /* N/m and N s/m, of the coupling now; 0 when it is rigid */
    vec3 stretch;            /* m, of the coupling: from the needle's base to the hand */
    vec3 before;             /* m, stretch when the last pose came: what the damper starts from */
    double age;              /* s of ticks since then */
    double energy, lowest;   /* J, from the hand into the coupling since the engagement, and the least that it was */
} virtual_coupling;

/* The hand at this pose takes the needle: coupling at rest, no energy yet; the delay is taken to be long until it is known. */
void coupling_engage(virtual_coupling *p, const pose_sample *hand);

/* Takes note of a pose; one that came before changes nothing. Returns the round trip (ns) of the wrench that it is the first
   to name, or -1. RT */
int64_t coupling_receive(virtual_coupling *p, const pose_sample *hand);

/* Where the coupling, whose hand end is at `hand`, would have the needle's base without force; `compliance` (m/N) is how far
   a force moves it from there in this tick of length dt (s). The stiffness is `limit` (N/m), or less, so that the loop is
   stable over the delay whatever is in the needle's way (README.md, "Devices"). RT */
pose coupling_hold(virtual_coupling *p, double limit, pose hand, double dt, double *compliance);

/* The tick is done, the base at `base` (m) under `force` (N, on the hand): returns the torque about the hand's point. RT */
vec3 coupling_yield(virtual_coupling *p, pose hand, vec3 base, vec3 force, vec3 torque);

/* Remembers a wrench that goes out. RT */
void coupling_send(virtual_coupling *p, int64_t tick, int64_t now, vec3 force, vec3 torque);

/* Has the hand got more energy than it gave, by more than can be told from nothing? RT */
bool coupling_active(const virtual_coupling *p);

#endif
