/* One solve: needle, contacts and tip brought into equilibrium. See README.md, "One tick is one convex problem". */
#ifndef TROCAR_EQUILIBRIUM_H
#define TROCAR_EQUILIBRIUM_H

#include "insertion/tick.h"

/* Finds the needle's shape and the forces and slips of the active contacts and, with scratch->tip, of the tip, whose element's corners
   have these handles in the snapshot. If there is no equilibrium, the needle lets go (EVENT_UNSTABLE). RT */
void equilibrium_find(const tick_context *tick, const int handles[4]);

/* Puts the contact problem together about the present shape and forces, in scratch->problem, and leaves it unsolved. Not `loaded`: the needle
   is as stiff as it is without the forces on it. */
void equilibrium_linearise(const tick_context *tick, const int handles[4], bool loaded);

/* Takes the forces off a needle that has buckled. RT */
void equilibrium_release(insertion_state *state);

#endif
