/* Drag on a needle that has no stable equilibrium. It damps the needle's bending waves while the needle moves to another equilibrium. See docs/mechanics.md,
   "Buckling". */
#ifndef TROCAR_NEEDLE_DRAG_H
#define TROCAR_NEEDLE_DRAG_H

#include "insertion/state/tick_data.h"

/* Returns this needle's drag coefficient in N s: moment per unit length, divided by the rate of rotation. */
double needle_drag(const needle_model *model);

/* Adds to the loads on the joints the drag on a needle that had the shape `start` when the step began. RT */
void drag_add_loads(const tick_input *tick, needle_response *response, const pass_checkpoint *start);

/* Adds the displacement caused by drag to the joints' displacement without loads. The compliance of all joints must already be known. RT */
void drag_shift_joints(const tick_input *tick, needle_response *response, const pass_checkpoint *start);

#endif
