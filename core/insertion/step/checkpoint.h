/* A checkpoint saves everything the Newton passes change, so that a step can be retried from the same starting point. */
#ifndef TROCAR_CHECKPOINT_H
#define TROCAR_CHECKPOINT_H

#include "insertion/state/tick_data.h"

/* RT */
void checkpoint_save(const insertion_state *state, const contact_points *points, const contact_problem *problem, pass_checkpoint *saved);

/* Rerunning the passes after a restore gives the same result, bit for bit, as running them right after the save. The caller must locate the points again first.
   RT */
void checkpoint_restore(insertion_state *state, const contact_points *points, contact_problem *problem, const pass_checkpoint *saved);

#endif
