/* What stops the tip: cutting force, membranes, bone. */
#ifndef TROCAR_OBSTACLE_H
#define TROCAR_OBSTACLE_H

#include "insertion/insertion_model.h"
#include "insertion/insertion_state.h"

/* Resistance of what is ahead of the tip, N (cutting or puncture). RT */
double tip_resistance(const insertion_model *model, const needle_tip *tip);

/* What stops the tip at a face, with element `behind` on the other side (-1: none): BLOCKED_BY_BONE, the strongest membrane there, or
   NOT_BLOCKED. RT */
int obstacle(const insertion_model *model, int tet, int face, int behind);

#endif
