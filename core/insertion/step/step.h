/* One step: the stages of core/insertion/README.md, one after the other. */
#ifndef TROCAR_STEP_H
#define TROCAR_STEP_H

#include "insertion/state/tick.h"

/* From one equilibrium to the next, with the base held as `tick` says. Scratch falls into structs that one stage writes and those after it read. RT */
void step(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

#endif
