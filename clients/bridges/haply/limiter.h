/* Limits the force that the device renders. */
#ifndef TROCAR_HAPLY_LIMITER_H
#define TROCAR_HAPLY_LIMITER_H

#include "base/vec.h"

typedef struct {
    double max_force;        /* N */
    double max_rate;         /* N/s */
    double gain;             /* factor applied to the whole force: 0 after a cut, then rises to 1 */
    double grip;             /* factor applied to the needle's force: 0 after a release, then rises to 1 */
    vec3 force;              /* N, force returned by the last call */
} limiter;

/* Computes the next force to render, `period` s after the last one, as the limited sum of the needle's force (`felt`) and a force that supports a weight
   (`carried`), both in N. Returns zero if a number is not finite. */
vec3 limiter_next(limiter *l, vec3 felt, vec3 carried, double period);

/* Lets go of the needle. After the last such call, its force rises from zero over 0.1 s. */
void limiter_let_go(limiter *l);

/* Sets the rendered force to zero at once. */
void limiter_cut(limiter *l);

#endif
