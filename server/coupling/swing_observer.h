/* Detects undamped oscillations of the hand. A swing is the motion from one turning point to the next. A passive coupling can only take energy out of
   a swing, and at turning points the hand has no kinetic energy, so each swing must be shorter than the one before. The positions alone show whether
   this holds, regardless of their delay relative to the forces. The code uses no threads and no clock: time is an argument. */
#ifndef TROCAR_SWING_OBSERVER_H
#define TROCAR_SWING_OBSERVER_H

#include <stdint.h>

#include "base/vec.h"

typedef struct {
    vec3 turn, farthest;     /* m, the last turning point, and the point farthest from it since */
    int64_t turned, reached; /* ns, times at which the hand was at `turn` and at `farthest` */
    vec3 force;              /* N, force at the time when the last turning point was detected */
    double stir;             /* N, largest change in the force since that turning point was detected */
    double lengths[2];       /* m, lengths of the last two swings, the newer one second */
    int lasting;             /* number of consecutive undamped swings */
} swing_observer;

/* Starts the observer with the hand at rest at `position` (m) at time `now` (ns). */
void swing_begin(swing_observer *s, vec3 position, int64_t now);

/* Takes the hand's position and the force on it (N). If an undamped swing has just ended, returns the number of such swings in a row; otherwise 0. To
   be counted, a swing must be longer than 0.2 mm, take less than 0.15 s, occur under a changing force, and be barely shorter than the swing one
   period earlier in the same direction. Slow hand motion is therefore not counted. RT */
int swing_observe(swing_observer *s, vec3 position, vec3 force, int64_t now);

#endif
