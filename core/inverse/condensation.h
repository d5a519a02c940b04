/* The inverse between the nodes of a region, K^-1_RR, from the factor of the whole matrix (condensation, Bro-Nielsen 1998). */
#ifndef TROCAR_CONDENSATION_H
#define TROCAR_CONDENSATION_H

#include "inverse/inverse.h"
#include "inverse/symmetric_blocks.h"

/* Factorises K, with the region's nodes last, and writes its inverse between nodes[inverse->count], the region's free ones; they are
   sorted by their place in the factor first. The factor is gone afterwards. Uses as many threads as BLAS does. Needs 8 (3 count)^2 / 2
   bytes and as much as `inverse` has beside it, or the factor if that is larger. Same errors as tissue_factor; BAD_INPUT
   also when the inverse over- or underflows. */
trocar_status condense(tissue *t, const condensed_region *region, int *nodes, symmetric_blocks *inverse, report *why);

#endif
