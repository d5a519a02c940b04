/* The paper's other way to a node on the needle: one of the mesh's own is moved there. */
#ifndef TROCAR_ORACLES_REFINEMENT_MOVE_H
#define TROCAR_ORACLES_REFINEMENT_MOVE_H

#include "refinement/refinement.h"

/* Moves the closest corner of the face of its leaf that x in `tet` is closest to, to x. Returns the slot, or -1 where it must stay: an anatomical,
   fixed, added or moved node, one whose elements would be inverted or too flat, one with too many neighbours, or the list is full. */
int refinement_move(const tissue *t, refinement *r, int tet, vec3 x, uint64_t id);

#endif
