/* The paper's other method of placing a node on the needle: moving one of the mesh's own nodes there. */
#ifndef TROCAR_ORACLES_REFINEMENT_MOVE_H
#define TROCAR_ORACLES_REFINEMENT_MOVE_H

#include "refinement/refinement.h"

/* Moves a node of the mesh to x: the corner closest to x, of the face closest to x, of the leaf in `tet` that contains x. Returns the slot, or -1 if the node
   must not be moved: because it is an anatomical, fixed, added or moved node, because its elements would be inverted or too flat, because it has too many
   neighbours, or because the list is full. */
int refinement_move(const tissue *t, refinement *r, int tet, vec3 x, uint64_t id);

#endif
