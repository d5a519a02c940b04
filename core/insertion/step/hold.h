/* The needle's side of the contact problem, for the worker. */
#ifndef TROCAR_INSERTION_HOLD_H
#define TROCAR_INSERTION_HOLD_H

#include "insertion/state/tick_data.h"
#include "snapshot/needle_hold.h"

/* Writes how the needle holds the tissue. To be called after insertion_tick, with the same workspace, whose contact problem it overwrites. RT */
void insertion_hold(const tick_input *tick, const insertion_state *state, insertion_workspace *w, needle_hold *hold);

#endif
