/* Displacements of the refined mesh, and how much each added node contributes to them. See docs/mechanics.md, "Node addition". */
#ifndef TROCAR_REFINED_FIELD_H
#define TROCAR_REFINED_FIELD_H

#include "inverse/inverse.h"
#include "refinement/refinement.h"

enum { REFINED_FIELD_SCRATCH = 7 };  /* scratch vectors per node */

/* One vector per node of the refined mesh: node_count entries in `nominal` and r->count in `added`. The contact nodes must be in consecutive slots
   (refinement_compact). */
typedef struct {
    vec3 *nominal, *added;
} refined_vectors;

/* Computes the displacements (m) of the refined mesh under nodal forces (N). `force` and `displacement` may be the same arrays. `scratch` has
   REFINED_FIELD_SCRATCH entries per node. If all added nodes are inside elements, the surpluses are solved exactly in closed form; if there are nodes on faces
   or moved nodes, the method of conjugate gradients is used, with one inverse_apply per iteration. For display and export. */
void refined_displacement(inverse *inv, const refinement *r, refined_vectors force, vec3 *scratch, refined_vectors displacement);

/* Returns d^-1 (m/N), the compliance of the hierarchical surplus of a node at this point of a leaf. Adding the node raises the compliance there by this much.
   */
mat3 surplus_compliance(const tissue *t, const refinement *r, int tet, const leaf_point *at);

/* Returns the compliance (m/N) of the surplus of the added contact node order[position]. For a node on a face, the adjacent nodes are treated as fixed.
   `position` may be r->count, as in patch_create. */
mat3 node_surplus(const tissue *t, const refinement *r, int position);

#endif
