/* Obstacles to the tip: cutting resistance, membranes and bone. */
#ifndef TROCAR_OBSTACLE_H
#define TROCAR_OBSTACLE_H

#include "insertion/state/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* Resistance (N) of element `tet` to a tip on a track with this openness (0 to 1). RT */
double cutting_resistance(const insertion_model *model, int tet, double openness);

/* The larger of cutting_resistance and the force (N) needed to pierce the obstacle at the tip: bone, or a membrane with this damage (0 to 1). RT */
double blocked_resistance(const insertion_model *model, int tet, double openness, int blocked_by, double damage);

/* Resistance (N), by cutting or puncture, ahead of the tip at its current position. RT */
double tip_resistance(const insertion_model *model, const needle_tip *tip);

/* Returns the obstacle at a face: BLOCKED_BY_BONE, the strongest membrane on the face, or NOT_BLOCKED. `behind`: element on the other side, -1 if none. RT */
int obstacle(const insertion_model *model, int tet, int face, int behind);

#endif
