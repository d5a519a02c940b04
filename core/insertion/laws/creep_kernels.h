/* The arithmetic of creep.c for all contact slots, one component at a time. */
#ifndef TROCAR_CREEP_KERNELS_H
#define TROCAR_CREEP_KERNELS_H

#include "snapshot/snapshot.h"

typedef double slot_vectors[3][CONTACT_COLUMNS]; /* [a]: component a in each slot; should be aligned to a cache line */

/* Adds to `moved` the displacements of this slot and of the later ones, up to `end`, caused by the load at this slot. Writes the displacement of this slot
   caused by the loads at the later ones to `by_beyond`. Slots without a point must have zero load. RT */
void slots_displace(const contact_rows *row, int slot, int end, slot_vectors load, slot_vectors moved, slot_vectors by_beyond);

#endif
