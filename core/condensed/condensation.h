/* Computes K^-1_RR, the part of the inverse between the nodes of a region (condensation, Bro-Nielsen 1998), from the factor of the region's
   stiffness after all other nodes have been eliminated. */
#ifndef TROCAR_CONDENSATION_H
#define TROCAR_CONDENSATION_H

#include "inverse/inverse.h"
#include "linalg/symmetric_blocks.h"

/* Returns the approximate memory (bytes) needed for the inversion in double precision: 36 count^2 each for factor and inverse. Single precision needs half as
   much. */
double condensation_bytes(int count);

/* Writes the region's free nodes, in the order of the matrix, to nodes[inverse->count], and the inverse between them to `inverse`. Assembles K if necessary.
   The result is bitwise identical for any value of region->threads. `needed` receives the required memory in bytes, which is known before the elimination
   begins; INFINITY if the mesh is too large. NO_MEMORY, before the elimination, if this exceeds the available memory; BAD_INPUT as in tissue_factor, or if
   the inverse overflows or underflows. */
trocar_status condense(tissue *t, const condensed_region *region, int *nodes, symmetric_blocks *inverse, double *needed, trocar_error *why);

#endif
