/* The one checkpoint of the passes: what they change can be saved, and gone back to. */
#ifndef TROCAR_CHECKPOINT_H
#define TROCAR_CHECKPOINT_H

#include "insertion/state/tick.h"

/* RT */
void checkpoint_save(const insertion_state *state, const contact_points *points, const contact_problem *problem, pass_checkpoint *saved);

/* The passes that follow find the same, to the bit, as if there had been none since the save. The points are yet to be located again. RT */
void checkpoint_restore(insertion_state *state, const contact_points *points, contact_problem *problem, const pass_checkpoint *saved);

#endif
