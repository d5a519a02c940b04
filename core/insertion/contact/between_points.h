/* Compliance of needle and tissue between the points of the contact problem. */
#ifndef TROCAR_BETWEEN_POINTS_H
#define TROCAR_BETWEEN_POINTS_H

#include "insertion/state/tick_data.h"

/* Stores P N P^T + R^T C R in the contact problem. N is the needle's compliance between joints; P interpolates it at the points and rotates it into their
   frames. C is the nominal tissue's compliance between points, which R rotates into the same frames. Guide points that the needle does not touch are decoupled.
   RT */
void assemble_between_points(const tick_input *tick, insertion_workspace *w);

#endif
