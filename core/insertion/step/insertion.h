/* The tick: how the base is held in, wrench out. Model constant, state mutable, no allocation, no clock. */
#ifndef TROCAR_INSERTION_H
#define TROCAR_INSERTION_H

#include "insertion/step/loads.h"
#include "insertion/state/tick.h"

/* Straight needle, held at `base`. Where it lies in the tissue it counts as inserted along its axis, without force. The tissue is as if the
   needle had never been there: it forgets what it remembers of the needle's forces, and the needle's tracks. RT */
void insertion_reset(const insertion_model *model, pose base, insertion_state *state);

/* One tick. Its time does not depend on the mesh, except for the search for the skin, O(log n), while the tip is outside or on it. No
   allocation, no lock, no library call. RT */
void insertion_tick(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

/* Puts together the contact problem of a tick that would not move the base, in w->problem, and leaves it unsolved. The state's memory
   of relaxing tissue goes on as in a tick. Not `loaded`: without what the forces add to the needle's stiffness. False: the needle
   touches no tissue. */
bool insertion_linearise(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output, bool loaded);

/* Are the output, and all numbers that the next tick starts from, finite? RT */
bool insertion_is_finite(const insertion_state *state, const tick_output *output);

/* After a tick that was not finite: starts over at `base`. The wrench becomes zero, its event UNSTABLE. RT */
void insertion_start_over(const insertion_model *model, pose base, insertion_state *state, tick_output *output);

#endif
