/* The inverse between the nodes of a region, K^-1_RR (condensation, Bro-Nielsen 1998), from the factor of the region's stiffness after all other
   nodes are eliminated. */
#ifndef TROCAR_CONDENSATION_H
#define TROCAR_CONDENSATION_H

#include "inverse/inverse.h"
#include "linalg/symmetric_blocks.h"

/* Approximate memory of the inversion in double precision: the factor and the inverse, 36 count^2 bytes each. Half of that in single precision. */
double condensation_bytes(int count);

/* Writes the inverse between nodes[inverse->count], the region's free nodes, which are sorted first. Assembles K if necessary. The result does not depend on
   region->threads, to the bit. `needed`: required bytes, known before the elimination begins; INFINITY if the mesh is too large. NO_MEMORY, before the
   elimination, if that exceeds the available memory; BAD_INPUT as in tissue_factor, or if the inverse overflows or underflows. */
trocar_status condense(tissue *t, const condensed_region *region, int *nodes, symmetric_blocks *inverse, double *needed, report *why);

#endif
