/* The tissue stage: lists the contact points and finds the tissue's compliance there from the newest snapshot. */
#ifndef TROCAR_TISSUE_STAGE_H
#define TROCAR_TISSUE_STAGE_H

#include "insertion/state/tick_data.h"

/* True if the needle touches tissue. RT */
static inline bool touches_tissue(const insertion_state *state) { return state->tip.place.phase == TIP_INSIDE || contact_is_active(state, 0); }

/* Lists the contact points and finds the tissue's compliance, memory and stiffening there. Returns false if there are no points. RT */
bool tissue_find(const tick_input *tick, insertion_state *state, contact_points *points, tissue_step *tissue, creep_step *creep, stiffening_step *stiffening,
                 damper_step *damper, tick_output *output);

#endif
