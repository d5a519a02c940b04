/* The resistance to the tip's advance in this step: uncut tissue, open tracks and their ends, calcifications, membranes, bone. Once per step, they are listed
   as stretches, each an interval of the tip's slip; the contact problem receives them as a single staircase. See docs/mechanics.md, "One tick is one convex
   problem". */
#ifndef TROCAR_RESISTANCE_AHEAD_H
#define TROCAR_RESISTANCE_AHEAD_H

#include "insertion/state/tick_data.h"

/* Lists the resistances ahead of the tip, up to the largest advance possible in this step. The points must have been located. RT */
void resistance_ahead_find(const tick_input *tick, const insertion_state *state, const hand_advance *hand, const path_step *path, const contact_points *points,
                           resistance_ahead *ahead);

/* Builds the tip's staircase for the forces of the last pass. `work_of_hold` (N): work per unit length needed to advance into tissue whose lateral support
   grows with depth. RT */
void resistance_ahead_climb(const tick_input *tick, const insertion_state *state, const contact_points *points, resistance_ahead *ahead, double work_of_hold,
                            staircase *climb);

/* Returns the open track along the stretch in which the tip's slip ended. RT */
open_track resistance_ahead_track(const resistance_ahead *ahead, const contact_problem *problem);

#endif
