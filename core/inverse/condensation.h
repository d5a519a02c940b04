/* The inverse between the nodes of a region, K^-1_RR, from the factor of the whole matrix (condensation, Bro-Nielsen 1998). */
#ifndef TROCAR_CONDENSATION_H
#define TROCAR_CONDENSATION_H

#include "inverse/inverse.h"
#include "inverse/symmetric_blocks.h"

/* The region's part of the factor and the triangle in double precision to which it is copied, 36 count^2 bytes each; or the triangle and the
   inverse, if that is in double precision. */
double condensation_bytes(int count);

/* Factorises K, with the region's nodes last, and writes its inverse between nodes[inverse->count], the region's free ones; they are
   sorted by their place in the factor first. The factor is gone afterwards. Uses as many threads as BLAS does. Needs the memory of the whole
   factor, then condensation_bytes. Same errors as tissue_factor; BAD_INPUT also when the inverse over- or underflows. */
trocar_status condense(tissue *t, const condensed_region *region, int *nodes, symmetric_blocks *inverse, report *why);

#endif
