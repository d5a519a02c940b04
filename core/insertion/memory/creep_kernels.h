/* The arithmetic of creep.c over all slots of contacts, by components. */
#ifndef TROCAR_CREEP_KERNELS_H
#define TROCAR_CREEP_KERNELS_H

#include "snapshot/snapshot.h"

typedef double slot_vectors[3][CONTACT_COLUMNS]; /* [a]: component a of each slot; should be aligned to a cache line */

/* Displacements between a slot and the slots beyond it, up to `end`, under the loads at both. Those at the slot itself, caused by the slots beyond, go to
   `by_beyond`. Slots without a point must have no load. RT */
void slots_displace(const contact_rows *row, int slot, int end, slot_vectors load, slot_vectors moved, slot_vectors by_beyond);

#endif
