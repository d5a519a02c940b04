/* Rigid motions of parts of the body, some tens of neighbouring nodes each: a coarse space for conjugate gradients, which then have to find the
   deformation of the parts alone (deflation: Nicolaides, SIAM J. Numer. Anal. 24, 1987). */
#ifndef TROCAR_COARSE_SPACE_H
#define TROCAR_COARSE_SPACE_H

#include "tissue/tissue.h"

typedef struct coarse_space coarse_space;

/* K must have been assembled. NULL: so few nodes that there would be one part, no memory, or K is not positive definite. */
coarse_space *coarse_space_create(const tissue *t);
void coarse_space_free(coarse_space *c);

/* motion = Z (Z^T K Z)^-1 Z^T force, dof_count each: rigid motions of the parts, Z, that leave no resultant of force - K motion on any of them.
   One call at a time. False: no memory. */
bool coarse_space_solve(coarse_space *c, const double *force, double *motion);

#endif
