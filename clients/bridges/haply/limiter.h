/* Limits the force that the device renders. */
#ifndef TROCAR_HAPLY_LIMITER_H
#define TROCAR_HAPLY_LIMITER_H

#include "base/vec.h"

typedef struct {
    double max_force;        /* N */
    double max_rate;         /* N/s */
    double gain;             /* factor on the total force: 0 after a cut, then rises to 1 */
    double grip;             /* factor on the needle's force: 0 after letting go, then rises to 1 */
    vec3 force;              /* N, force last returned */
} limiter;

/* Computes the force to render `period` s after the last one: the sum of the needle's force (`felt`) and a force that carries the tool's weight (`carried`),
   both in N, after limiting. Returns zero if a number is not finite. */
vec3 limiter_next(limiter *l, vec3 felt, vec3 carried, double period);

/* Lets go of the needle: its force becomes zero, and rises over 0.1 s after the last such call. */
void limiter_let_go(limiter *l);

/* Sets the rendered force to zero at once. */
void limiter_cut(limiter *l);

#endif
