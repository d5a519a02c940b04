/* A coarse space for conjugate gradients: the rigid motions of parts of the body, each of which consists of a few tens of neighbouring nodes. The
   iteration then only has to find the deformation within the parts (deflation: Nicolaides, SIAM J. Numer. Anal. 24, 1987). */
#ifndef TROCAR_COARSE_SPACE_H
#define TROCAR_COARSE_SPACE_H

#include "tissue/tissue.h"

typedef struct coarse_space coarse_space;

/* Creates the coarse space of a tissue whose K is assembled. Returns NULL if the mesh has only one part, if memory is exhausted, or if K is not positive
   definite. */
coarse_space *coarse_space_create(const tissue *t);
void coarse_space_free(coarse_space *c);

/* Computes motion = Z (Z^T K Z)^-1 Z^T force (dof_count entries each), where Z contains the rigid motions of the parts. Afterwards, the residual force -
   K motion has no resultant force or moment on any part. Not thread-safe. Returns false if there is no memory. */
bool coarse_space_solve(coarse_space *c, const double *force, double *motion);

#endif
