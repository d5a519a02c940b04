/* What stops the tip: cutting force, membranes, bone. */
#ifndef TROCAR_OBSTACLE_H
#define TROCAR_OBSTACLE_H

#include "insertion/state/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* Resistance of the tissue of element `tet` to a tip along a track that is open to this degree (0 to 1), N. RT */
double cutting_resistance(const insertion_model *model, int tet, double open);

/* The same, or what it takes to pierce what blocks the tip, if that is more: bone, or a membrane damaged to this degree (0 to 1). RT */
double blocked_resistance(const insertion_model *model, int tet, double open, int blocked_by, double damage);

/* Resistance of what is ahead of the tip where it is, N (cutting or puncture). RT */
double tip_resistance(const insertion_model *model, const needle_tip *tip);

/* What stops the tip at a face, with element `behind` on the other side (-1: none): BLOCKED_BY_BONE, the strongest membrane there, or
   NOT_BLOCKED. RT */
int obstacle(const insertion_model *model, int tet, int face, int behind);

#endif
