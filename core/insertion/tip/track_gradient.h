/* Deformation of the tissue around the tip, which rotates the direction in which the tip cuts. */
#ifndef TROCAR_TRACK_GRADIENT_H
#define TROCAR_TRACK_GRADIENT_H

#include "insertion/state/tick_data.h"

/* Derivative of the tissue's displacement along the track at the tip. It is a finite difference over a fixed length, because the gradient in the tip's
   element would depend on the element's size. Behind the tip, the displacement is that of the shaft; ahead of the tip, that of the mesh. RT */
vec3 track_gradient(const tick_input *tick, const insertion_state *state, const creep_step *creep);

#endif
