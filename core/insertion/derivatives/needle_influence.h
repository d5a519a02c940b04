/* How forces at the contact points move these points, turn the tangents there, and move the needle's end. */
#ifndef TROCAR_NEEDLE_INFLUENCE_H
#define TROCAR_NEEDLE_INFLUENCE_H

#include "insertion/state/tick_data.h"

enum { POINT_AXES = 3 * MAX_POINTS };

/* Response to a unit force on the needle at point j along axis b of that point's frame, in column 3 j + b. The base is held. */
typedef struct {
    double moved[POINT_AXES][POINT_AXES];           /* m/N, row 3 i + a: displacement of point i along its axis a */
    double turned[2 * MAX_POINTS][POINT_AXES];      /* rad/N, row 2 i + a: change in the tangent at point i along its axis a */
    vec3 end[POINT_AXES];                           /* m/N, world frame: displacement of the needle's end */
    vec3 end_turned[POINT_AXES];                    /* rad/N, world frame: change in the direction of the needle's end */
} needle_influence;

/* Computes the influence from the needle's tangent stiffness in w->response. */
void needle_influence_find(const tick_input *tick, const insertion_workspace *w, needle_influence *influence);

/* Returns the unit vector along the last segment. */
vec3 needle_end_direction(const tick_input *tick, const needle_state *needle);

#endif
