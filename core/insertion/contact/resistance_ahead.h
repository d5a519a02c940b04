/* What resists the tip on its way forward in this step: whole tissue, open tracks and their ends, membranes, bone. Each kind of resistance is listed
   once a step, as stretches over the tip's slip; the contact problem gets them as one staircase. See docs/mechanics.md, "One tick is one convex problem". */
#ifndef TROCAR_RESISTANCE_AHEAD_H
#define TROCAR_RESISTANCE_AHEAD_H

#include "insertion/state/tick.h"

/* Lists what is ahead of the tip, as far as it may come in this step. The points are located. RT */
void resistance_ahead_find(const tick_input *tick, const insertion_state *state, const hand_advance *hand, const path_step *path, const contact_points *points,
                           resistance_ahead *ahead);

/* The staircase that the tip climbs, under the forces of the last pass. `work_of_hold`, N: what it takes to go on into tissue that holds the needle
   the more, the deeper it is. RT */
void resistance_ahead_climb(const tick_input *tick, const insertion_state *state, const contact_points *points, resistance_ahead *ahead, double work_of_hold,
                            staircase *climb);

/* The track on the stretch that the tip's slip ended on. RT */
open_track resistance_ahead_track(const resistance_ahead *ahead, const contact_problem *problem);

#endif
