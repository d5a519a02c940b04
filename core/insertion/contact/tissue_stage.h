/* The tissue stage: where the needle touches something, and how the tissue there yields, with what the newest snapshot knows. */
#ifndef TROCAR_TISSUE_STAGE_H
#define TROCAR_TISSUE_STAGE_H

#include "insertion/state/tick.h"

/* Does the needle touch tissue? RT */
static inline bool touches_tissue(const insertion_state *state) { return state->tip.place.phase == TIP_INSIDE || contact_is_active(state, 0); }

/* Lists the points of contact and finds compliance, memory and stiffening of the tissue at them. False: there are none. RT */
bool tissue_find(const tick_input *tick, insertion_state *state, contact_points *points, tissue_step *tissue, creep_step *creep, stiffening_step *stiffening,
                 damper_step *damper, tick_output *output);

#endif
