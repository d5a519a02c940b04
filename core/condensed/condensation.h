/* The inverse between the nodes of a region, K^-1_RR (condensation, Bro-Nielsen 1998), computed from the factor of the region's stiffness after the
   elimination of all other nodes. */
#ifndef TROCAR_CONDENSATION_H
#define TROCAR_CONDENSATION_H

#include "inverse/inverse.h"
#include "linalg/symmetric_blocks.h"

/* Approximate memory of the inversion in double precision: factor and inverse, 36 count^2 bytes each. Single precision needs half of that. */
double condensation_bytes(int count);

/* Writes the inverse between nodes[inverse->count], the region's free nodes, which are sorted first. Assembles K if necessary. The result is bitwise identical
   for any value of region->threads. `needed` receives the required bytes, which are known before the elimination begins; INFINITY if the mesh is too large.
   NO_MEMORY, before the elimination, if they exceed the available memory; BAD_INPUT as in tissue_factor, or if the inverse overflows or underflows. */
trocar_status condense(tissue *t, const condensed_region *region, int *nodes, symmetric_blocks *inverse, double *needed, trocar_error *why);

#endif
