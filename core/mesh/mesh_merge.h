/* Merges coincident nodes, which occur in files whose regions were meshed or exported separately. */
#ifndef TROCAR_MESH_MERGE_H
#define TROCAR_MESH_MERGE_H

#include "mesh/mesh.h"

typedef struct {
    int merged;              /* number of nodes merged with another node */
    int apart;               /* number of nodes that coincide with another node but whose faces do not match */
    int example;             /* index, before merging, of one of the nodes counted in `apart`, or -1 */
} mesh_merge_result;

/* Joins bodies at matching faces by merging the faces' nodes. Reads and changes nodes and tets; `renumbered` (node_count) receives the new number of each
   node. If the status is NO_MEMORY, nothing has changed. */
trocar_status mesh_merge(mesh *m, int *renumbered, mesh_merge_result *result);

#endif
