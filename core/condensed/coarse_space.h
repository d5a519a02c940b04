/* Rigid motions of parts of the body, each of a few tens of neighbouring nodes: a coarse space for conjugate gradients, which then only have to find the
   deformation of the parts (deflation: Nicolaides, SIAM J. Numer. Anal. 24, 1987). */
#ifndef TROCAR_COARSE_SPACE_H
#define TROCAR_COARSE_SPACE_H

#include "tissue/tissue.h"

typedef struct coarse_space coarse_space;

/* K must be assembled. Returns NULL if the mesh has only one part, memory is exhausted, or K is not positive definite. */
coarse_space *coarse_space_create(const tissue *t);
void coarse_space_free(coarse_space *c);

/* Computes motion = Z (Z^T K Z)^-1 Z^T force (dof_count entries each), where Z contains the rigid motions of the parts. Afterwards, force - K motion has
   no resultant on any part. Not thread-safe. Returns false if there is no memory. */
bool coarse_space_solve(coarse_space *c, const double *force, double *motion);

#endif
