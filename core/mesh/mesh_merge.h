/* Merges coincident nodes, as in files whose regions were meshed or exported separately. */
#ifndef TROCAR_MESH_MERGE_H
#define TROCAR_MESH_MERGE_H

#include "mesh/mesh.h"

typedef struct {
    int merged;              /* nodes merged with another */
    int apart;               /* nodes that coincide with another but whose faces do not match */
    int example;             /* original number of one of the nodes counted in `apart`, or -1 */
} mesh_merge_result;

/* Joins bodies at matching faces by merging their nodes. Reads and changes nodes and tets; `renumbered` (node_count) receives the
   new number of each node. NO_MEMORY: nothing changed. */
trocar_status mesh_merge(mesh *m, int *renumbered, mesh_merge_result *result);

#endif
