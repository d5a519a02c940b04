/* A coarse space for conjugate gradients: the body is divided into parts of a few tens of neighbouring nodes, and the space contains their rigid motions. The
   iteration then only has to find the deformation within the parts (deflation: Nicolaides, SIAM J. Numer. Anal. 24, 1987). */
#ifndef TROCAR_COARSE_SPACE_H
#define TROCAR_COARSE_SPACE_H

#include "tissue/tissue.h"

typedef struct coarse_space coarse_space;

/* Creates a tissue's coarse space; K must be assembled. Returns NULL if the mesh has only one part, if out of memory, or if K is not positive definite. */
coarse_space *coarse_space_create(const tissue *t);
void coarse_space_free(coarse_space *c);

/* Computes motion = Z (Z^T K Z)^-1 Z^T force (dof_count entries each), where Z contains the rigid motions of the parts. The residual force - K motion then has
   no net force or moment on any part. Returns false if out of memory. Not thread-safe. */
bool coarse_space_solve(coarse_space *c, const double *force, double *motion);

#endif
