/* The arithmetic of creep.c for all contact slots, one component at a time. */
#ifndef TROCAR_CREEP_KERNELS_H
#define TROCAR_CREEP_KERNELS_H

#include "snapshot/snapshot.h"

typedef double slot_vectors[3][CONTACT_COLUMNS]; /* [a]: component a in each slot; should be aligned to a cache line */

/* Adds to `moved` how far the load at this slot displaces this slot and the later ones, up to `end`. Writes to `by_beyond` how far the loads at the later slots
   displace this one. Slots without a point must have zero load. RT */
void slots_displace(const contact_rows *row, int slot, int end, slot_vectors load, slot_vectors moved, slot_vectors by_beyond);

#endif
