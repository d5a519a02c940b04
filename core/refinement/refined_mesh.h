/* The refined mesh as plain arrays: the nominal nodes, then the contact nodes. */
#ifndef TROCAR_REFINED_MESH_H
#define TROCAR_REFINED_MESH_H

#include "refinement/refinement.h"

typedef struct {
    int node_count, tet_count;
    vec3 *nodes;             /* [node_count], m. If a contact node is a moved nominal node, no element uses its own entry */
    int (*tets)[4];          /* [tet_count]: corner nodes */
    int *parent;             /* [tet_count]: the nominal element that contains each tetrahedron */
} refined_mesh;

/* Creates the arrays. The contact nodes must be in consecutive slots (refinement_compact). Allocates. NO_MEMORY. */
trocar_status refined_mesh_create(const mesh *m, const refinement *r, refined_mesh *out, trocar_error *why);
void refined_mesh_free(refined_mesh *out);

#endif
