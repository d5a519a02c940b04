/* Obstacles to the tip: cutting force, membranes, bone. */
#ifndef TROCAR_OBSTACLE_H
#define TROCAR_OBSTACLE_H

#include "insertion/state/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* Resistance of element `tet` to a tip on a track with this openness (0 to 1), N. RT */
double cutting_resistance(const insertion_model *model, int tet, double openness);

/* The larger of cutting_resistance and the force needed to pierce the obstacle at the tip, N: bone, or a membrane with this damage (0 to 1). RT */
double blocked_resistance(const insertion_model *model, int tet, double openness, int blocked_by, double damage);

/* Resistance ahead of the tip at its present position, N (cutting or puncture). RT */
double tip_resistance(const insertion_model *model, const needle_tip *tip);

/* The obstacle at a face with element `behind` on the other side (-1: none): BLOCKED_BY_BONE, the strongest membrane on the face, or NOT_BLOCKED. RT */
int obstacle(const insertion_model *model, int tet, int face, int behind);

#endif
