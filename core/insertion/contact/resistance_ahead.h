/* The resistance to the tip's advance in this step: uncut tissue, open tracks and their ends, calcifications, membranes, bone. Once per step, they are listed
   as stretches, each of which covers an interval of the tip's slip. The contact problem gets them combined into one staircase. See docs/mechanics.md, "One tick
   is one convex problem". */
#ifndef TROCAR_RESISTANCE_AHEAD_H
#define TROCAR_RESISTANCE_AHEAD_H

#include "insertion/state/tick_data.h"

/* Lists the resistances ahead of the tip, as far as it can advance in this step. Call points_locate first. RT */
void resistance_ahead_find(const tick_input *tick, const insertion_state *state, const hand_advance *hand, const path_step *path, const contact_points *points,
                           resistance_ahead *ahead);

/* Builds the staircase for the tip, given the forces of the last pass. `work_of_hold` (N): extra work per metre of advance where the tissue's lateral support
   grows with depth. RT */
void resistance_ahead_climb(const tick_input *tick, const insertion_state *state, const contact_points *points, resistance_ahead *ahead, double work_of_hold,
                            staircase *climb);

/* Returns the open track in the stretch where the tip's slip ended. RT */
open_track resistance_ahead_track(const resistance_ahead *ahead, const contact_problem *problem);

#endif
