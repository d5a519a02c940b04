/* A hand on the needle's handle: a mass on a spring to its target position, damped relative to the ground, and pushed by the needle. */
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

/* Advances the hand by dt (s) towards `target` (m) under `force` (N, on the hand), both constant over the step. Uses the exact solution of m a + c
   v + k (x - target) = force, stable for every dt. */
void hand_step(hand *h, vec3 target, vec3 force, double dt);

#endif
