/* How stiffly the needle holds the tissue, for the worker. */
#ifndef TROCAR_INSERTION_HOLD_H
#define TROCAR_INSERTION_HOLD_H

#include "insertion/state/tick_data.h"
#include "snapshot/needle_hold.h"

/* Writes the compliance of the needle at the points where it holds the tissue. Call this after insertion_tick with the same workspace; it overwrites the
   workspace's contact problem. RT */
void insertion_hold(const tick_input *tick, const insertion_state *state, insertion_workspace *w, needle_hold *hold);

#endif
