/* The order in which nodes are eliminated. */
#ifndef TROCAR_NODE_ORDER_H
#define TROCAR_NODE_ORDER_H

#include "tissue/tissue.h"

/* Sparsity pattern of K between free nodes, lower triangle: the three dofs of a node have the same neighbours. K must be assembled. NULL if there is no
   memory. */
cholmod_sparse *node_graph(tissue *t);

/* Marks the free nodes among these, indexed by first dof / 3; the caller frees the result. NULL if there is no memory. */
bool *mark_free_nodes(const tissue *t, int count, const int *nodes);

/* Nested dissection of some free nodes, ignoring all others: writes them to order[count]. False if there is no memory. */
bool node_dissect(tissue *t, const cholmod_sparse *graph, int count, const int *nodes, int *order);

/* Nested dissection of the free nodes, order[dof_count / 3]; nodes marked `last` (indexed by first dof / 3) are moved to the end. The separators of the mesh
   still separate the remaining nodes. False if there is no memory. */
bool node_order(tissue *t, cholmod_sparse *graph, const bool *last, int *order);

#endif
