/* The checkpoint of the passes: saves and restores everything that they change. */
#ifndef TROCAR_CHECKPOINT_H
#define TROCAR_CHECKPOINT_H

#include "insertion/state/tick_data.h"

/* RT */
void checkpoint_save(const insertion_state *state, const contact_points *points, const contact_problem *problem, pass_checkpoint *saved);

/* After the restore, the passes give a result that is bitwise identical to that of passes directly after the save. The points must be located again. RT */
void checkpoint_restore(insertion_state *state, const contact_points *points, contact_problem *problem, const pass_checkpoint *saved);

#endif
