/* Finds the equilibrium of needle, contacts and tip. See docs/mechanics.md, "One tick is one convex problem". */
#ifndef TROCAR_EQUILIBRIUM_H
#define TROCAR_EQUILIBRIUM_H

#include "insertion/state/tick_data.h"

/* Finds the needle's shape, and the forces and slips at the points listed by the tissue stage. If there is no stable equilibrium nearby, the needle starts
   moving to another one. RT */
void equilibrium_find(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

/* Call this when the needle touches nothing: discards the starting point for the next equilibrium. RT */
void equilibrium_forget(insertion_state *state);

/* Assembles the contact problem for the current shape and forces in w->problem, without solving it. If `loaded` is false, uses the stiffness of an unloaded
   needle. Call it after the tissue stage. */
void equilibrium_linearise(const tick_input *tick, insertion_state *state, insertion_workspace *w, bool loaded);

/* Then linearises stiffening tissue again, about the forces in `state`, and updates the problem's compliance. Needle and guides stay as they were. */
void equilibrium_linearise_laws(const tick_input *tick, const insertion_state *state, insertion_workspace *w);

#endif
