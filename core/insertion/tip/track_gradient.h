/* Deformation of the tissue around the tip, which rotates the tip's cutting direction. */
#ifndef TROCAR_TRACK_GRADIENT_H
#define TROCAR_TRACK_GRADIENT_H

#include "insertion/state/tick.h"

/* Derivative of the tissue's displacement along the track at the tip, as a difference over a fixed length: the gradient in the tip's element would depend on
   the element's size. The displacement behind the tip is that of the shaft, the one ahead that of the mesh. RT */
vec3 track_gradient(const tick_input *tick, const insertion_state *state, const creep_step *creep);

#endif
