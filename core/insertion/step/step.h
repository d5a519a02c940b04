/* One step of a tick: runs the stages listed in core/insertion/README.md in order. */
#ifndef TROCAR_STEP_H
#define TROCAR_STEP_H

#include "insertion/state/tick_data.h"

/* Computes the next equilibrium for the base at `tick->base`. Each struct in the workspace is written by one stage and read by later ones. RT */
void step(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

#endif
