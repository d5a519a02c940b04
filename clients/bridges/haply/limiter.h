/* Limits of the force that the device renders. */
#ifndef TROCAR_HAPLY_LIMITER_H
#define TROCAR_HAPLY_LIMITER_H

#include "base/vec.h"

typedef struct {
    double max_force;        /* N */
    double max_rate;         /* N/s */
    double gain;             /* factor on everything: 0 after a cut, then rises to 1 */
    double grip;             /* factor on the needle's force: 0 after a release, then rises to 1 */
    vec3 force;              /* N, the newest */
} limiter;

/* The next force, `period` s after the last, from the needle's force and a force that carries a weight, both in N. Zero if a number is not finite. */
vec3 limiter_next(limiter *l, vec3 felt, vec3 carried, double period);

/* Releases the needle: its force rises from zero over the next 0.1 s. */
void limiter_let_go(limiter *l);

/* Sets the force to zero at once. */
void limiter_cut(limiter *l);

#endif
