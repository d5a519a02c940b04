/* Displacements of the refined mesh, and what one added node contributes to them. See docs/mechanics.md,
   "Node addition". */
#ifndef TROCAR_REFINED_FIELD_H
#define TROCAR_REFINED_FIELD_H

#include "inverse/inverse.h"
#include "refinement/refinement.h"

enum { REFINED_FIELD_SCRATCH = 7 };  /* vectors of scratch for each node */

/* One vector for each node of the refined mesh: `nominal` has node_count entries, `added` r->count. The contact nodes are in slots without
   gaps (refinement_compact). */
typedef struct {
    vec3 *nominal, *added;
} refined_vectors;

/* Displacements of the refined mesh under nodal forces (N -> m), which may be in the same place; `scratch`:
   REFINED_FIELD_SCRATCH times both. Exact: inside elements the surplus is solved in closed form, with nodes on faces or moved all by
   conjugate gradients, with an inverse_apply a step. For display and export. */
void refined_displacement(inverse *inv, const refinement *r, refined_vectors force, vec3 *scratch, refined_vectors displacement);

/* Compliance d^-1 of the hierarchical surplus of a node at this leaf point, m/N: what adding it contributes. */
mat3 surplus_compliance(const tissue *t, const refinement *r, int tet, const leaf_point *at);

/* The same of the contact node in place `position` of the order, an added one: on a face, as if the nodes beside it were held. `position`
   may be r->count, as in patch_create. */
mat3 node_surplus(const tissue *t, const refinement *r, int position);

#endif
