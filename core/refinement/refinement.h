/* The refined part of the mesh: contact nodes, each added inside an element or on a face. An addition moves no node, so the new finite-element space
   contains the old one. This is not true if a nominal node is moved (`moved`), which only tests and benchmarks do. See docs/mechanics.md, "Node addition"
   and "Remeshing methods". */
#ifndef TROCAR_REFINEMENT_H
#define TROCAR_REFINEMENT_H

#include "refinement/leaves.h"

/* Adds a node at x in `tet`; if x is nearly on a face of its leaf, the node is shifted inside. Returns its slot, or -1 if the refinement is full. RT */
int refinement_add(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id);

/* Adds a node on the face of its leaf that is closest to x in `tet`; if x is nearly on an edge, the node is shifted away from it. For tests and
   benchmarks: in an insertion, nodes are on faces only as a result of removing others. RT */
int refinement_add_on_face(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id);

/* Returns the index in `order` of the node with this id, or -1. RT */
int refinement_find(const refinement *r, uint64_t id);

/* Removes the node with this id; the other nodes keep their slots and positions. The leaves that the node had split become whole again, so later nodes in
   these leaves split different leaves than before: the mesh is the one that results from adding the remaining nodes in the same order. Returns the freed slot.
   Returns -1 if there is no such node, or if it is not the last one and either it or a node added after it was moved. RT */
int refinement_remove(const mesh *m, refinement *r, uint64_t id);

/* True if a leaf split by this node has a corner in one of these slots (bit i: slot i). RT */
bool refinement_hangs_on(const added_node *node, uint64_t slots);

/* Highest slot in use plus one. RT */
int refinement_span(const refinement *r);

/* Copies the first `count` nodes in order, renumbered: slot i is the i-th. */
void refinement_compact(const refinement *r, int count, refinement *out);

#endif
