/* The tick: computes the wrench on the base from the pose of the base's mount. The model is immutable, the state is mutable. No allocation, no clock. */
#ifndef TROCAR_TICK_H
#define TROCAR_TICK_H

#include "insertion/step/loads.h"
#include "insertion/state/tick_data.h"

/* Resets to a straight needle with its base at `base`. If the needle overlaps the tissue there, it is treated as already inserted along its axis, without
   force. The tissue forgets this needle's forces and tracks. RT */
void insertion_reset(const insertion_model *model, pose base, insertion_state *state);

/* Computes one tick. The cost does not depend on the size of the mesh, except that a tip outside the tissue or on the skin searches for the skin in O(log n).
   No allocation, no locks, no library calls. RT */
void insertion_tick(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

/* Call this between two ticks after the tissue's moduli have changed. RT */
void insertion_soften(const tick_input *tick, insertion_state *state, insertion_workspace *w);

/* Assembles in w->problem, without solving it, the contact problem of a tick in which the base does not move. As in a tick, the memory of relaxing tissue
   advances. If `loaded` is false, leaves out the stiffness that the forces add to the needle. Returns false if the needle touches no tissue. */
bool insertion_linearise(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output, bool loaded);

/* True if the output and the state are finite. RT */
bool insertion_is_finite(const insertion_state *state, const tick_output *output);

/* Restarts at `base` after a tick whose result was not finite. Returns a zero wrench and the UNSTABLE event. RT */
void insertion_start_over(const insertion_model *model, pose base, insertion_state *state, tick_output *output);

#endif
