/* The tick: from the mount of the base to the wrench. The model is constant, the state mutable; no allocation, no clock. */
#ifndef TROCAR_INSERTION_H
#define TROCAR_INSERTION_H

#include "insertion/step/loads.h"
#include "insertion/state/tick.h"

/* Resets to a straight needle, held at `base`. Where the needle overlaps the tissue, it counts as inserted along its axis without force. The tissue forgets
   this needle's forces and tracks. RT */
void insertion_reset(const insertion_model *model, pose base, insertion_state *state);

/* Computes one tick. Its cost is independent of the mesh, except for the search for the skin, O(log n), while the tip is outside or on it. No allocation, no
   lock, no library call. RT */
void insertion_tick(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

/* Assembles the contact problem of a tick that would not move the base, in w->problem, without solving it. The state's memory of relaxing tissue advances as
   in a tick. If not `loaded`, the stiffness that the forces add to the needle is left out. Returns false if the needle touches no tissue. */
bool insertion_linearise(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output, bool loaded);

/* True if the output and the state are finite. RT */
bool insertion_is_finite(const insertion_state *state, const tick_output *output);

/* Restarts at `base` after a tick that was not finite. Sets the wrench to zero and the event UNSTABLE. RT */
void insertion_start_over(const insertion_model *model, pose base, insertion_state *state, tick_output *output);

#endif
