/* The refined part of the mesh: nodes added inside elements, each splitting its leaf in four. Splitting moves no node, so
   the old finite-element space stays inside the new one. See README.md, "Node addition is a nested refinement". */
#ifndef TROCAR_REFINEMENT_H
#define TROCAR_REFINEMENT_H

#include "inverse.h"

enum { MAX_CONTACTS = 64 }; /* added nodes alive at once */

/* A node that the insertion adds to the nominal mesh. */
typedef struct {
    uint64_t id;             /* never used twice in one insertion state */
    int tet;                 /* nominal element that contains it */
    vec3 position;           /* nominal, m; strictly inside its leaf */
    int corners[4];          /* the leaf that it splits: nominal node >= 0, added node -1 - index */
    double weights[4];       /* its barycentric weights there */
} added_node;

/* The refined part of the mesh: added nodes in order of creation; each splits the leaf that contains it in four. */
typedef struct {
    int count;
    added_node nodes[MAX_CONTACTS + 1]; /* room for the tip as one more, in an export */
} refinement;

/* A point of the refined mesh: leaf corners (coded as above) and barycentric weights. */
typedef struct {
    int corners[4];
    double weights[4];
} leaf_point;

/* The leaf of nominal element `tet` that contains x, counting only the first `active` added nodes. */
leaf_point refinement_locate(const mesh *m, const refinement *r, int active, int tet, vec3 x);

/* Appends a node at x in `tet`, shifted inside where x is nearly on a face of its leaf. Returns its index, or -1 when full. */
int refinement_add(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id);

/* The refined mesh written out: nominal nodes, then the added ones; `parent` is each tet's nominal element. */
typedef struct {
    int node_count, tet_count;
    vec3 *nodes;
    int (*tets)[4];
    int *parent;
} refined_mesh;
trocar_status refined_mesh_create(const mesh *m, const refinement *r, refined_mesh *out, report *why);
void refined_mesh_free(refined_mesh *out);

/* Displacements of the refined mesh under nodal forces (N -> m): `nominal` node_count, `added` r->count entries each.
   Exact: the added nodes' surplus is solved in closed form. For display and export. */
void refinement_displacement(inverse *inv, const refinement *r, const vec3 *nominal_force, const vec3 *added_force,
                             vec3 *nominal, vec3 *added);

/* Compliance d^-1 of the hierarchical surplus of a node at this leaf point, m/N: what adding it contributes. */
mat3 surplus_compliance(const tissue *t, const refinement *r, int tet, const leaf_point *at);

#endif
