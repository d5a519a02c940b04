/* Detects oscillations of the hand that do not decay. A passive coupling only takes energy out of a swing, and at turning points the hand has
   no kinetic energy, so each swing is shorter than the one before. The positions alone show whether that is so, whatever their delay relative
   to the forces. No threads, no clock: time is an argument. */
#ifndef TROCAR_SWING_OBSERVER_H
#define TROCAR_SWING_OBSERVER_H

#include <stdint.h>

#include "base/vec.h"

typedef struct {
    vec3 turn, farthest;     /* m, the last turning point, and the point farthest from it since */
    int64_t turned, reached; /* ns, when the hand was at `turn` and at `farthest` */
    vec3 force;              /* N, when the last turning point was detected */
    double stir;             /* N, largest change of the force since then */
    double lengths[2];       /* m, lengths of the last two swings, the newer one second */
    int lasting;             /* consecutive swings that did not decay */
} swing_observer;

/* Starts the observer with the hand at rest at `position` (m) at the time `now` (ns). */
void swing_begin(swing_observer *s, vec3 position, int64_t now);

/* Takes the hand's position and the force on it (N). If a swing that did not decay has just ended, returns the number of such swings in a row, else
   0. Each of them moved the hand by more than 0.2 mm within 0.15 s, under a changing force, and was hardly shorter than the swing one period before
   in the same direction, so that slow motion of the hand is not counted. RT */
int swing_observe(swing_observer *s, vec3 position, vec3 force, int64_t now);

#endif
