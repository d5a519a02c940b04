/* The inverse between the nodes of a region, K^-1_RR (condensation, Bro-Nielsen 1998), from the factor of the region's stiffness once all other
   nodes are eliminated. */
#ifndef TROCAR_CONDENSATION_H
#define TROCAR_CONDENSATION_H

#include "inverse/inverse.h"
#include "linalg/symmetric_blocks.h"

/* About what the inversion needs in double precision: the factor and the inverse, 36 count^2 bytes each. In single precision it is half of that. */
double condensation_bytes(int count);

/* Writes the inverse between nodes[inverse->count], the region's free ones, which are sorted first. K is assembled if need be. The
   bits do not depend on region->threads. `needed`: bytes, known before the elimination begins; INFINITY if the mesh is too large for it.
   NO_MEMORY, before the elimination, if that is more than is available; BAD_INPUT as of tissue_factor, and when the inverse over- or underflows. */
trocar_status condense(tissue *t, const condensed_region *region, int *nodes, symmetric_blocks *inverse, double *needed, report *why);

#endif
