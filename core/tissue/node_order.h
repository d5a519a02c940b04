/* The order in which nodes are eliminated from the stiffness matrix. */
#ifndef TROCAR_NODE_ORDER_H
#define TROCAR_NODE_ORDER_H

#include "tissue/tissue.h"

/* Sparsity pattern of K between free nodes, as a lower triangle; the three dofs of a node have the same neighbours. K must be assembled. NULL if there is
   no memory. */
cholmod_sparse *node_graph(tissue *t);

/* Marks which of these nodes are free, indexed by first dof / 3; the caller frees the result. NULL if there is no memory. */
bool *mark_free_nodes(const tissue *t, int count, const int *nodes);

/* Orders some of the free nodes by nested dissection, ignoring all others, and writes them to order[count]. Returns false if there is no memory. */
bool node_dissect(tissue *t, const cholmod_sparse *graph, int count, const int *nodes, int *order);

/* Orders the free nodes by nested dissection, order[dof_count / 3]. Nodes marked `last` (indexed by first dof / 3) are moved to the end; the separators of
   the mesh still separate the other nodes. Returns false if there is no memory. */
bool node_order(tissue *t, cholmod_sparse *graph, const bool *last, int *order);

#endif
