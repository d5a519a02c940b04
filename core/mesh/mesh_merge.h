/* Merges coincident nodes, found in files whose regions were meshed or exported separately. */
#ifndef TROCAR_MESH_MERGE_H
#define TROCAR_MESH_MERGE_H

#include "mesh/mesh.h"

typedef struct {
    int merged;              /* number of nodes merged into another node */
    int apart;               /* number of nodes that coincide with another node but were not merged, because their faces do not match */
    int example;             /* index, before merging, of one of the nodes counted in `apart`; -1 if there are none */
} mesh_merge_result;

/* Joins bodies at matching faces by merging the faces' nodes. Changes `nodes`, `tets` and `node_count`; writes the new number of each of the original nodes to
   `renumbered`. NO_MEMORY, changing nothing. */
trocar_status mesh_merge(mesh *m, int *renumbered, mesh_merge_result *result);

#endif
