/* Surfaces on which organs slide (mesh/sliding_surface.h), as springs between the pairs of nodes on their two sides. Along the normal, a spring keeps the two
   sides in contact; it also pulls, so they cannot come apart. See docs/mechanics.md, "Organs that slide". */
#ifndef TROCAR_SLIDING_STIFFNESS_H
#define TROCAR_SLIDING_STIFFNESS_H

#include "mesh/mesh.h"

/* Force per area and per displacement of one side relative to the other. */
typedef struct {
    double normal;           /* N/m^3 */
    double shear;            /* N/m^3, along the surface; 0: no friction */
} sliding_material;

/* Computes the stiffness (N/m) that ties a pair's two nodes: K u = block (u0 - u1) at nodes[0], and the opposite at nodes[1]. `materials` has an entry for each
   group of the mesh, of which only those of sliding surfaces are used. */
mat3 pair_stiffness(const node_pair *pair, const sliding_material *materials);

/* Adds to a hash (base/hash.h) everything that the springs contribute to K. Returns it unchanged if there are none. */
uint64_t sliding_hash(uint64_t h, const mesh *m, const sliding_material *materials);

#endif
