/* Forces that the stress in one region exerts on the nodes. */
#ifndef TROCAR_REGION_FORCES_H
#define TROCAR_REGION_FORCES_H

#include "tissue/tissue.h"

/* Computes the part of K u that belongs to a region (group index of dimension 3): `force` (N) under the displacements u (m), node_count entries each. The sum
   over all regions is K u at the nodes that are not fixed, except for the membranes' part. NO_MEMORY. */
trocar_status region_forces(const tissue *t, int region, const vec3 *u, vec3 *force, trocar_error *why);

#endif
