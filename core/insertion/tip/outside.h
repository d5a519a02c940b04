/* Detects a limitation of the model: a shaft pushed into a body sideways meets no force there. The tick reports it. */
#ifndef TROCAR_OUTSIDE_H
#define TROCAR_OUTSIDE_H

#include "insertion/state/tick_data.h"

/* Checks one segment of the needle per tick. Sets EVENT_OUTSIDE_MODEL in every tick in which a segment is in a body but not in the needle's track. RT */
void outside_watch(const tick_input *tick, insertion_state *state, tick_output *output);

#endif
