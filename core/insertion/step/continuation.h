/* What equilibrium_find does if the passes find no stable equilibrium near the last one: it repeats the step in small increments along the branch of
   equilibria. Where the branch ends, the needle moves to another one against its drag. See docs/mechanics.md, "Buckling". */
#ifndef TROCAR_CONTINUATION_H
#define TROCAR_CONTINUATION_H

#include "insertion/step/passes.h"

/* Starts from the checkpoint w->start. Leaves state->moving_on set as long as the needle is still moving to another equilibrium. RT */
pass_result continuation_follow(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output);

#endif
