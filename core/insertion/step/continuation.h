/* The fallback of equilibrium_find if the passes find no stable equilibrium near the last one: the step is repeated in small increments along the branch
   of equilibria. Where the branch ends, the needle moves to another one against its drag. See docs/mechanics.md, "Buckling". */
#ifndef TROCAR_CONTINUATION_H
#define TROCAR_CONTINUATION_H

#include "insertion/step/passes.h"

/* Starts from the checkpoint w->start. Sets state->moving_on while no equilibrium is near. RT */
pass_result continuation_follow(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

#endif
