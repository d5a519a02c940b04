/* Detects oscillations of the hand that do not decay. A passive coupling only takes energy from a swing, and at turning points the hand has no
   kinetic energy, so each swing is shorter than the one before. The positions alone show this, whatever their delay relative to the forces. No
   threads, no clock: time is an argument. */
#ifndef TROCAR_SWING_OBSERVER_H
#define TROCAR_SWING_OBSERVER_H

#include <stdint.h>

#include "base/vec.h"

typedef struct {
    vec3 turn, farthest;     /* m, the last turning point, and the point farthest from it since */
    int64_t turned, reached; /* ns, time of each */
    vec3 force;              /* N, when the last turning point was detected */
    double stir;             /* N, largest change of the force since */
    double lengths[2];       /* m, of the last two swings, the newer one second */
    int lasting;             /* consecutive swings that did not decay */
} swing_observer;

/* The hand rests at `position` (m) at the time `now` (ns). */
void swing_begin(swing_observer *s, vec3 position, int64_t now);

/* The hand is at `position`, under `force` (N). If a swing that did not decay has just been detected, returns how many there were in a row, else 0.
   Each moved the hand by more than 0.2 mm within 0.15 s, under a changing force, and was hardly shorter than the one a period before in the same
   direction, so that slow motion of the hand does not matter. RT */
int swing_observe(swing_observer *s, vec3 position, vec3 force, int64_t now);

#endif
