/* The tick: computes the wrench on the base from the pose of its mount. The model is immutable, and the state is mutable. No allocation, no clock. */
#ifndef TROCAR_TICK_H
#define TROCAR_TICK_H

#include "insertion/step/loads.h"
#include "insertion/state/tick_data.h"

/* Resets to a straight needle whose base is held at `base`. Where the needle overlaps the tissue, it is treated as inserted along its axis without force. The
   tissue forgets this needle's forces and tracks. RT */
void insertion_reset(const insertion_model *model, pose base, insertion_state *state);

/* Computes one tick. Its cost is independent of the size of the mesh, except for the search for the skin, O(log n), while the tip is outside or on the
   skin. No allocation, no lock, no library call. RT */
void insertion_tick(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

/* Adopts changed moduli between two ticks. RT */
void insertion_soften(const tick_input *tick, insertion_state *state, insertion_workspace *w);

/* Assembles in w->problem, without solving it, the contact problem of a tick in which the base does not move. The state's memory of relaxing tissue
   advances as in a tick. Unless `loaded` is true, the stiffness that the forces add to the needle is left out. Returns false if the needle touches no
   tissue. */
bool insertion_linearise(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output, bool loaded);

/* True if the output and the state are finite. RT */
bool insertion_is_finite(const insertion_state *state, const tick_output *output);

/* Restarts at `base` after a tick whose result was not finite. Sets the wrench to zero and the event UNSTABLE. RT */
void insertion_start_over(const insertion_model *model, pose base, insertion_state *state, tick_output *output);

#endif
