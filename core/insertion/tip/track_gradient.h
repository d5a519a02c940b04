/* Deformation of the tissue around the tip, which turns the direction in which the tip cuts. */
#ifndef TROCAR_TRACK_GRADIENT_H
#define TROCAR_TRACK_GRADIENT_H

#include "insertion/state/tick_data.h"

/* Returns the derivative of the tissue's displacement along the track at the tip. It is a finite difference over a fixed length, because the gradient in the
   tip's element would depend on the size of that element. Behind the tip, the displacement is the shaft's; ahead of it, the mesh's. RT */
vec3 track_gradient(const tick_input *tick, const insertion_state *state, const creep_step *creep);

#endif
