/* The paper's other way of putting a node on the needle: moving one of the mesh's own nodes there. */
#ifndef TROCAR_ORACLES_REFINEMENT_MOVE_H
#define TROCAR_ORACLES_REFINEMENT_MOVE_H

#include "refinement/refinement.h"

/* Moves a mesh node to x. The node is the corner nearest to x, of the face nearest to x, of the leaf in `tet` that contains x. Returns the slot, or -1 if
   the node must not be moved: because it is anatomical, fixed, added or already moved, because its elements would become inverted or too flat, because it
   has too many neighbours, or because the list is full. */
int refinement_move(const tissue *t, refinement *r, int tet, vec3 x, uint64_t id);

#endif
