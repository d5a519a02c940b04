/* Model of a hand on the needle's handle: a mass that is pulled towards its target position by a spring, damped relative to the ground, and pushed by
   the needle. */
#ifndef TROCAR_HAND_H
#define TROCAR_HAND_H

#include "base/vec.h"

typedef struct {
    double mass;             /* kg, > 0 */
    double damping;          /* N s/m, >= 0 */
    double stiffness;        /* N/m, > 0 */
    vec3 position;           /* m */
    vec3 velocity;           /* m/s */
} hand;

/* Advances the hand by dt (s) towards `target` (m) under `force` (N, exerted on the hand), both constant during the step. Uses the exact solution of
   m a + c v + k (x - target) = force, which is stable for every dt. */
void hand_step(hand *h, vec3 target, vec3 force, double dt);

#endif
