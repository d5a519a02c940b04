/* Brings needle, contacts and tip into equilibrium. See docs/mechanics.md, "One tick is one convex problem". */
#ifndef TROCAR_EQUILIBRIUM_H
#define TROCAR_EQUILIBRIUM_H

#include "insertion/state/tick.h"

/* Finds the needle's shape, and the forces and slips at the points listed by the tissue stage. If no stable equilibrium is near, the needle moves to another
   one. RT */
void equilibrium_find(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

/* For a needle without contact: clears the starting point of the next equilibrium. RT */
void equilibrium_forget(insertion_state *state);

/* Assembles the contact problem about the present shape and forces, in w->problem, without solving it. If not `loaded`, the needle's stiffness is that of the
   needle without forces. Call after the tissue stage. */
void equilibrium_linearise(const tick_input *tick, insertion_state *state, insertion_workspace *w, bool loaded);

#endif
