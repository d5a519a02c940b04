/* Brings needle, contacts and tip into equilibrium. See docs/mechanics.md, "One tick is one convex problem". */
#ifndef TROCAR_EQUILIBRIUM_H
#define TROCAR_EQUILIBRIUM_H

#include "insertion/state/tick_data.h"

/* Finds the needle's shape, and the forces and slips at the points that the tissue stage has listed. If no stable equilibrium is near, the needle moves to
   another one. RT */
void equilibrium_find(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

/* For a needle without contact: discards the starting point for the next equilibrium. RT */
void equilibrium_forget(insertion_state *state);

/* Assembles the contact problem for the current shape and forces in w->problem, without solving it. Unless `loaded` is true, the stiffness is that of an
   unloaded needle. To be called after the tissue stage. */
void equilibrium_linearise(const tick_input *tick, insertion_state *state, insertion_workspace *w, bool loaded);

#endif
