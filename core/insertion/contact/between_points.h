/* Compliance of needle and tissue between the points of the contact problem. */
#ifndef TROCAR_BETWEEN_POINTS_H
#define TROCAR_BETWEEN_POINTS_H

#include "insertion/state/tick.h"

/* Stores P N P^T + R^T C R in the contact problem: the needle's compliance N between joints, interpolated at the points and turned into their
   frames by P, and the nominal tissue's C between points, turned by the frames R. What rests at an open guide is coupled with nothing. RT */
void assemble_between_points(const tick_input *tick, insertion_workspace *w);

#endif
