/* One solve: needle, contacts and tip brought into equilibrium. See README.md, "One tick is one convex problem". */
#ifndef TROCAR_EQUILIBRIUM_H
#define TROCAR_EQUILIBRIUM_H

#include "insertion/insertion.h"

/* Finds the needle's shape and the forces and slips of the active contacts and, with w->tip, of the tip, whose point the
   snapshot covers with `handles`. Where there is no equilibrium the needle lets go (EVENT_UNSTABLE). RT */
void equilibrium_find(const insertion_model *model, insertion_state *state, insertion_workspace *w, const compliance_snapshot *snapshot,
                      const int handles[4], double dt, insertion_wrench *wrench);

/* Takes the forces off a needle that has buckled. RT */
void equilibrium_release(insertion_state *state);

#endif
