/* A model of a hand on the needle's handle: a mass that a spring pulls towards its target position, with damping to ground, and that the needle pushes. */
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

/* Advances the hand by dt (s), with constant `target` (m) and `force` (N, exerted on the hand). Uses the exact solution of
   m a + c v + k (x - target) = force, which is stable for any dt. */
void hand_step(hand *h, vec3 target, vec3 force, double dt);

#endif
