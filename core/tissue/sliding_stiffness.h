/* Surfaces on which organs slide (mesh/sliding_surface.h), as springs between the pairs of nodes on their two sides. Along the normal, a spring keeps the two
   sides in contact; it also pulls, so they cannot come apart. See docs/mechanics.md, "Organs that slide". */
#ifndef TROCAR_SLIDING_STIFFNESS_H
#define TROCAR_SLIDING_STIFFNESS_H

#include "base/hash.h"
#include "mesh/mesh.h"

/* Force per area and per displacement of one side relative to the other. */
typedef struct {
    double normal;           /* N/m^3 */
    double shear;            /* N/m^3, along the surface; 0: no friction */
} sliding_material;

/* Computes the stiffness (N/m) that ties a pair's two nodes: K u = block (u0 - u1) at nodes[0], and the opposite at nodes[1]. `materials` has an entry for each
   group of the mesh, of which only those of sliding surfaces are used. */
static inline mat3 pair_stiffness(const node_pair *pair, const sliding_material *materials) {
    const sliding_material *material = &materials[pair->group];
    const double n[3] = {pair->normal.x, pair->normal.y, pair->normal.z};
    mat3 k;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) k.m[i][j] = pair->area * (material->shear * (i == j) + (material->normal - material->shear) * n[i] * n[j]);
    return k;
}

/* Adds to a hash (base/hash.h) everything that the springs contribute to K. Returns it unchanged if there are none. */
static inline uint64_t sliding_hash(uint64_t h, const mesh *m, const sliding_material *materials) {
    for (int i = 0; i < m->pair_count; i++) {
        const node_pair *pair = &m->pairs[i];
        const sliding_material *material = &materials[pair->group];
        const double values[] = {pair->nodes[0], pair->nodes[1], pair->normal.x, pair->normal.y, pair->normal.z, pair->area, material->normal, material->shear};
        h = hash_bytes(h, values, sizeof values);
    }
    return h;
}

#endif
