/* The refined part of the mesh: contact nodes, each added inside an element or on a face. Adding a node moves no other node, so the new finite-element space
   contains the old one. This does not hold if a nominal node is moved (`moved`), which only tests and benchmarks do. See docs/mechanics.md, "Node addition" and
   "Remeshing methods". */
#ifndef TROCAR_REFINEMENT_H
#define TROCAR_REFINEMENT_H

#include "refinement/leaves.h"

/* Adds a node at x in `tet`. If x is nearly on a face of its leaf, the node is shifted inward. Returns the node's slot, or -1 if the refinement is full. RT */
int refinement_add(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id);

/* Adds a node on the face of its leaf that is closest to x in `tet`. If x is nearly on an edge, the node is shifted away from the edge. For tests and
   benchmarks: during an insertion, a node ends up on a face only when another node is removed. RT */
int refinement_add_on_face(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id);

/* Returns the index in `order` of the node with this id, or -1. RT */
int refinement_find(const refinement *r, uint64_t id);

/* Removes the node with this id. The other nodes keep their slots and positions. The leaves it had split become whole again, so nodes added later in these
   leaves now split different ones: the mesh becomes what it would be if only the remaining nodes had been added, in the same order. Returns the freed slot, or
   -1 if there is no such node. Also returns -1 if it is not the last node and either it or one added after it was moved. RT */
int refinement_remove(const mesh *m, refinement *r, uint64_t id);

/* Returns whether a leaf split by this node has a corner in one of these slots (bit i: slot i). RT */
bool refinement_hangs_on(const added_node *node, uint64_t slots);

/* Returns the highest slot in use plus one. RT */
int refinement_span(const refinement *r);

/* Copies the first `count` nodes in `order` and renumbers them, so that the i-th gets slot i. */
void refinement_compact(const refinement *r, int count, refinement *out);

#endif
