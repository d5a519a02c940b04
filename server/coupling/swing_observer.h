/* Detects undamped oscillations of the hand. A swing is the motion from one turning point to the next. The hand has no kinetic energy at a turning point, and a
   passive coupling can only take energy out of a swing, so each swing must be shorter than the one before. Positions alone show whether this holds, however
   late they are relative to the forces. These functions don't touch threads or the clock: the time is passed in. */
#ifndef TROCAR_SWING_OBSERVER_H
#define TROCAR_SWING_OBSERVER_H

#include <stdint.h>

#include "base/vec.h"

typedef struct {
    vec3 turn, farthest;     /* m, the last turning point, and the point reached since that is farthest from it */
    int64_t turned, reached; /* ns, when the hand was at `turn` and at `farthest` */
    vec3 force;              /* N, force when the last turning point was detected */
    double stir;             /* N, largest change in the force since then */
    double lengths[2];       /* m, lengths of the last two swings, older one first */
    int lasting;             /* number of consecutive undamped swings */
} swing_observer;

/* Starts observing a hand at rest at `position` (m), at time `now` (ns). */
void swing_begin(swing_observer *s, vec3 position, int64_t now);

/* Takes the hand's position and the force on it (N). If an undamped swing has just ended, returns how many there have been in a row; otherwise 0. A swing
   counts if it is longer than 0.2 mm, takes less than 0.15 s, happens while the force changes, and is barely shorter than the swing one period earlier in the
   same direction. Slow motion of the hand is therefore ignored. RT */
int swing_observe(swing_observer *s, vec3 position, vec3 force, int64_t now);

#endif
