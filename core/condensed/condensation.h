/* Condensation (Bro-Nielsen 1998): computes K^-1_RR, the inverse between the nodes of a region R, by eliminating all other nodes and inverting the factor of
   the remaining stiffness. */
#ifndef TROCAR_CONDENSATION_H
#define TROCAR_CONDENSATION_H

#include "inverse/inverse.h"
#include "linalg/symmetric_blocks.h"

/* Returns roughly how much memory (bytes) the inversion takes in double precision: 36 count^2 each for factor and inverse. Single precision takes half. */
double condensation_bytes(int count);

/* Writes the region's free nodes, in the order of the matrix, to nodes[inverse->count], and the inverse between them to `inverse`. Assembles K if necessary.
   The result is bitwise identical for any region->threads. `needed` receives the memory required, in bytes, or INFINITY if the mesh is too large. NO_MEMORY,
   before starting the elimination, if that much is not available; BAD_INPUT as in tissue_factor, or if the inverse overflows or underflows. */
trocar_status condense(tissue *t, const condensed_region *region, int *nodes, symmetric_blocks *inverse, double *needed, trocar_error *why);

#endif
