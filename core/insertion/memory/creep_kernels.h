/* The arithmetic of creep.c, of all slots of contacts by components. */
#ifndef TROCAR_CREEP_KERNELS_H
#define TROCAR_CREEP_KERNELS_H

#include "snapshot/snapshot.h"

typedef double slot_vectors[3][CONTACT_COLUMNS]; /* [a]: component a of each slot; best on a cache line */

/* What the loads at a slot and at those beyond, up to `end`, displace at each other; by those beyond, at the slot itself, in `by_beyond`. Slots that
   are no points' are without load. RT */
void slots_displace(const contact_rows *row, int slot, int end, slot_vectors load, slot_vectors moved, slot_vectors by_beyond);

#endif
