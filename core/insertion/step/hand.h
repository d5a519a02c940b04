/* The hand stage: the shaft slides by the slips of the last solve, and the hand moves the base. */
#ifndef TROCAR_HAND_H
#define TROCAR_HAND_H

#include "insertion/state/tick_data.h"

/* Slides the shaft past its contacts and through guides by the slips of the last solve. RT */
void hand_slide_shaft(const tick_input *tick, insertion_state *state);

/* Moves the base to the hand's new pose and records how far this moves the needle's end. Outside the tissue the needle is straight, unless a guide bends it.
   RT */
void hand_move(const tick_input *tick, insertion_state *state, hand_advance *hand);

#endif
