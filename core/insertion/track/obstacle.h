/* Obstacles to the tip: tissue that has to be cut, calcifications, membranes and bone. */
#ifndef TROCAR_OBSTACLE_H
#define TROCAR_OBSTACLE_H

#include "insertion/model/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* Returns the distance (m) from x at which the ray along the unit vector `direction` enters the calcification; INFINITY if x is inside or the ray misses it.
   RT */
double calcification_entry(const calcification *c, vec3 x, vec3 direction);

/* Returns the resistance (N) of tissue at the nominal point x of element `tet` to a tip on a track of this openness (0, uncut, to 1). RT */
double cutting_resistance(const insertion_model *model, int tet, vec3 x, double openness);

/* Returns the force (N) needed to get past the obstacle at the tip: bone, or a membrane with this damage (0 to 1); but at least cutting_resistance. RT */
double blocked_resistance(const insertion_model *model, int tet, vec3 x, double openness, int blocked_by, double damage);

/* Returns the cutting or puncture resistance (N) ahead of the tip where it is now. RT */
double tip_resistance(const insertion_model *model, const needle_tip *tip);

/* Returns the obstacle at a face: BLOCKED_BY_BONE, the strongest membrane on the face, or NOT_BLOCKED. `behind`: element on the other side, or -1. RT */
int obstacle(const insertion_model *model, int tet, int face, int behind);

#endif
