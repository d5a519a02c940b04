/* Finds oscillations of the hand that do not die away. A passive coupling can only take energy from a swing: at its turning points the
   hand has no kinetic energy, so that each swing is shorter than the one before. This shows in the positions alone, whatever the delay
   between them and the forces. No threads, no clock: time is an argument. */
#ifndef TROCAR_SWING_OBSERVER_H
#define TROCAR_SWING_OBSERVER_H

#include <stdint.h>

#include "base/vec.h"

typedef struct {
    vec3 turn, farthest;     /* m, the last turning point, and the point farthest from it since */
    int64_t turned, reached; /* ns, when the hand was there */
    vec3 force;              /* N, when the last turning point was noticed */
    double stir;             /* N, greatest change of the force since */
    double lengths[2];       /* m, of the last two swings, the newer one second */
    int lasting;             /* swings in a row that did not die away */
} swing_observer;

/* The hand rests at `position` (m) at the time `now` (ns). */
void swing_begin(swing_observer *s, vec3 position, int64_t now);

/* The hand is at `position`, under `force` (N). Returns the number of swings in a row that did not die away, if one more has just been
   noticed, else 0: each moved the hand by more than 0.2 mm within 0.15 s, under a force that changed, and was hardly shorter than the
   one a period before, in the same direction, so that a slow motion of the hand does not matter. RT */
int swing_observe(swing_observer *s, vec3 position, vec3 force, int64_t now);

#endif
