/* The arithmetic of creep.c for all slots of contacts, one component at a time. */
#ifndef TROCAR_CREEP_KERNELS_H
#define TROCAR_CREEP_KERNELS_H

#include "snapshot/snapshot.h"

typedef double slot_vectors[3][CONTACT_COLUMNS]; /* [a]: component a in each slot; should be aligned to a cache line */

/* Computes the displacements that the loads at this slot and at the later slots, up to `end`, cause at each other. The displacement of the slot itself,
   caused by the later slots, is written to `by_beyond`. Slots without a point must have no load. RT */
void slots_displace(const contact_rows *row, int slot, int end, slot_vectors load, slot_vectors moved, slot_vectors by_beyond);

#endif
