/* Nodes that lie at the same place, as where regions were meshed or exported one by one. */
#ifndef TROCAR_MESH_MERGE_H
#define TROCAR_MESH_MERGE_H

#include "tissue/mesh.h"

typedef struct {
    int merged;              /* nodes that became one with another */
    int apart;               /* nodes that lie where another one does, but faces there do not match */
    int example;             /* one of the latter, old number; -1: none */
} mesh_merge_result;

/* Joins bodies where their faces match: the nodes of both become one. Needs nodes and tets, and changes these; renumbered
   (node_count) receives the new number of each old node. NO_MEMORY: nothing changed. */
trocar_status mesh_merge(mesh *m, int *renumbered, mesh_merge_result *result);

#endif
