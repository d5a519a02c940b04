/* Needle, contacts and tip are brought into equilibrium. See docs/mechanics.md, "One tick is one convex problem". */
#ifndef TROCAR_EQUILIBRIUM_H
#define TROCAR_EQUILIBRIUM_H

#include "insertion/state/tick.h"

/* Finds the needle's shape and the forces and slips of the points of the tissue stage. Where no stable equilibrium is near, the needle moves on to another
   one. RT */
void equilibrium_find(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

/* Nothing holds the needle: what the next equilibrium would start from. RT */
void equilibrium_forget(insertion_state *state);

/* Puts the contact problem together about the present shape and forces, in w->problem, and leaves it unsolved. Not `loaded`: the needle
   is as stiff as it is without the forces on it. After the tissue stage. */
void equilibrium_linearise(const tick_input *tick, insertion_state *state, insertion_workspace *w, bool loaded);

#endif
