/* Displacements of the refined mesh, and the contribution of one added node to these displacements. See docs/mechanics.md, "Node addition". */
#ifndef TROCAR_REFINED_FIELD_H
#define TROCAR_REFINED_FIELD_H

#include "inverse/inverse.h"
#include "refinement/refinement.h"

enum { REFINED_FIELD_SCRATCH = 7 };  /* scratch vectors per node */

/* One vector for each node of the refined mesh: `nominal` has node_count entries, `added` r->count. The contact nodes must be in consecutive slots
   (refinement_compact). */
typedef struct {
    vec3 *nominal, *added;
} refined_vectors;

/* Computes the displacements (m) of the refined mesh under nodal forces (N); the two may share the same memory. `scratch` has REFINED_FIELD_SCRATCH entries
   per node. The result is exact: if all added nodes are inside elements, the surpluses are solved in closed form; with nodes on faces or moved nodes,
   conjugate gradients are used, with one inverse_apply per step. For display and export. */
void refined_displacement(inverse *inv, const refinement *r, refined_vectors force, vec3 *scratch, refined_vectors displacement);

/* Compliance d^-1 (m/N) of the hierarchical surplus of a node at this leaf point, which is what adding the node contributes to the compliance there. */
mat3 surplus_compliance(const tissue *t, const refinement *r, int tet, const leaf_point *at);

/* Compliance (m/N) of the surplus of the added contact node order[position]; for a node on a face, as if the adjacent nodes were fixed. `position` may be
   r->count, as in patch_create. */
mat3 node_surplus(const tissue *t, const refinement *r, int position);

#endif
