/* Forces on the nodes due to the stress in one region. */
#ifndef TROCAR_REGION_FORCES_H
#define TROCAR_REGION_FORCES_H

#include "tissue/tissue.h"

/* Computes a region's part of K u: `force` (N) due to the displacements u (m), node_count entries each. `region`: group index of dimension 3. At nodes that are
   not fixed, the sum over all regions is K u without the membranes' part. NO_MEMORY. */
trocar_status region_forces(const tissue *t, int region, const vec3 *u, vec3 *force, trocar_error *why);

#endif
