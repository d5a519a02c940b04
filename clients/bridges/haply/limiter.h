/* Limits the force that the device renders. */
#ifndef TROCAR_HAPLY_LIMITER_H
#define TROCAR_HAPLY_LIMITER_H

#include "base/vec.h"

typedef struct {
    double max_force;        /* N */
    double max_rate;         /* N/s */
    double gain;             /* factor on the whole force: 0 after a cut, then rising to 1 */
    double grip;             /* factor on the needle's force: 0 after a release, then rising to 1 */
    vec3 force;              /* N, the newest force */
} limiter;

/* Returns the next force, `period` s after the last one, from the needle's force and a force that carries a weight, both in N; zero if a number is
   not finite. */
vec3 limiter_next(limiter *l, vec3 felt, vec3 carried, double period);

/* Releases the needle: its force starts again from zero and rises over the next 0.1 s. */
void limiter_let_go(limiter *l);

/* Sets the force to zero at once. */
void limiter_cut(limiter *l);

#endif
