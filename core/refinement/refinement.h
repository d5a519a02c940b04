/* The refined part of the mesh: contact nodes, each added inside an element or on a face. Adding moves no node, so the old finite-element space
   stays inside the new one. One of the mesh's own nodes that was moved (`moved`), which does not keep it, comes from tests and benchmarks alone.
   See docs/mechanics.md, "Node addition" and "Remeshing methods". */
#ifndef TROCAR_REFINEMENT_H
#define TROCAR_REFINEMENT_H

#include "refinement/leaves.h"

/* Adds a node at x in `tet`, shifted inside where x is nearly on a face of its leaf. Returns its slot, or -1 when full. RT */
int refinement_add(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id);

/* Adds a node on the face of its leaf that x in `tet` is closest to, shifted inside where x is nearly on an edge: for tests and benchmarks. In an
   insertion, nodes come to lie on faces when others are removed. RT */
int refinement_add_on_face(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id);

/* The node `id` in `order`, or -1. RT */
int refinement_find(const refinement *r, uint64_t id);

/* Removes the node `id`; the others keep their slots and positions. Leaves that it had split are whole again, so that later nodes in them
   split other leaves than before: the mesh is the one that the nodes left over make when they are added in the same order. Returns the
   slot that is free now, or -1: there is no such node, or it, or one added after it, was moved, and it is not the last one. RT */
int refinement_remove(const mesh *m, refinement *r, uint64_t id);

/* Does a leaf that this node splits have a corner in one of these slots (bit i: slot i)? RT */
bool refinement_hangs_on(const added_node *node, uint64_t slots);

/* One more than the highest slot in use. RT */
int refinement_span(const refinement *r);

/* The first `count` nodes in order, numbered anew: slot i is the i-th. */
void refinement_compact(const refinement *r, int count, refinement *out);

#endif
