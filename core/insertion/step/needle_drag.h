/* A needle that no stable equilibrium holds moves on to another one against the drag that damps its waves of bending. See
   docs/mechanics.md, "Buckling". */
#ifndef TROCAR_NEEDLE_DRAG_H
#define TROCAR_NEEDLE_DRAG_H

#include "insertion/state/tick.h"

/* N s, drag of this needle: moment per length that a rate of turning meets. */
double needle_drag(const needle_model *model);

/* Adds to the loads on the joints what drags a needle that has moved on from `start` in this step. RT */
void drag_add_loads(const tick_input *tick, needle_response *response, const pass_checkpoint *start);

/* Adds to the joints' displacement at zero load what the drag displaces. The compliance of all joints must be known. RT */
void drag_shift_joints(const tick_input *tick, needle_response *response, const pass_checkpoint *start);

#endif
