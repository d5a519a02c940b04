/* The paper's other method to get a node on the needle: one of the mesh's own nodes is moved there. */
#ifndef TROCAR_ORACLES_REFINEMENT_MOVE_H
#define TROCAR_ORACLES_REFINEMENT_MOVE_H

#include "refinement/refinement.h"

/* Moves to x the closest corner of the leaf's face that is closest to x in `tet`. Returns the slot, or -1 if the node must stay: an anatomical,
   fixed, added or moved node, a node whose elements would be inverted or too flat, a node with too many neighbours, or a full list. */
int refinement_move(const tissue *t, refinement *r, int tet, vec3 x, uint64_t id);

#endif
