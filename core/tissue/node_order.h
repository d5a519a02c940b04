/* The order in which nodes are eliminated from the stiffness matrix. */
#ifndef TROCAR_NODE_ORDER_H
#define TROCAR_NODE_ORDER_H

#include "tissue/tissue.h"

/* Returns the sparsity pattern of K between free nodes, as a lower triangle; the three dofs of a node have the same neighbours. K must be assembled. NULL if
   out of memory. */
cholmod_sparse *node_graph(tissue *t);

/* Marks which of these nodes are free, indexed by first dof / 3. The caller frees the result. NULL if out of memory. */
bool *mark_free_nodes(const tissue *t, int count, const int *nodes);

/* Orders some of the free nodes by nested dissection, ignoring all others, and writes them to order[count]. Returns false if out of memory. */
bool node_dissect(tissue *t, const cholmod_sparse *graph, int count, const int *nodes, int *order);

/* Orders the free nodes by nested dissection, order[dof_count / 3]. Nodes marked `last` (indexed by first dof / 3) move to the end; the mesh's separators still
   separate the other nodes. Returns false if out of memory. */
bool node_order(tissue *t, cholmod_sparse *graph, const bool *last, int *order);

#endif
