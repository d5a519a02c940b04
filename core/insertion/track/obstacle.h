/* Obstacles to the tip: cutting resistance, calcifications, membranes and bone. */
#ifndef TROCAR_OBSTACLE_H
#define TROCAR_OBSTACLE_H

#include "insertion/model/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* Distance (m) along the ray from x, in the unit vector `direction`, at which the ray enters the calcification; INFINITY if x is inside or the ray misses
   it. RT */
double calcification_entry(const calcification *c, vec3 x, vec3 direction);

/* Resistance (N) at the nominal point x of element `tet` to a tip on a track with this openness (0, uncut, to 1). RT */
double cutting_resistance(const insertion_model *model, int tet, vec3 x, double openness);

/* The larger of cutting_resistance and the force (N) needed to pierce the obstacle at the tip: bone, or a membrane with this damage (0 to 1). RT */
double blocked_resistance(const insertion_model *model, int tet, vec3 x, double openness, int blocked_by, double damage);

/* Cutting or puncture resistance (N) ahead of the tip at its current position. RT */
double tip_resistance(const insertion_model *model, const needle_tip *tip);

/* Returns the obstacle at a face: BLOCKED_BY_BONE, the strongest membrane on the face, or NOT_BLOCKED. `behind`: element on the other side, -1 if none. RT */
int obstacle(const insertion_model *model, int tet, int face, int behind);

#endif
