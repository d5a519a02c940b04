/* What the model leaves out: a shaft that is pushed into a body from the side. It bears no force there, and is told. */
#ifndef TROCAR_OUTSIDE_H
#define TROCAR_OUTSIDE_H

#include "insertion/state/tick.h"

/* Looks at one segment of the needle in each tick. EVENT_OUTSIDE_MODEL as long as one of them was in a body, off the needle's track. RT */
void outside_watch(const tick_input *tick, insertion_state *state, tick_output *output);

#endif
