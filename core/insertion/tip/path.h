/* The path stage: the tip goes through the undeformed tissue by the slip of the last solve, or touches the surface; what is open to it, and which holes the
   needle is in. */
#ifndef TROCAR_PATH_H
#define TROCAR_PATH_H

#include "insertion/state/tick.h"

/* `gradient`: of the tissue's displacement along the track, before the hand moved (track_gradient.h). RT */
void path_follow(const tick_input *tick, insertion_state *state, const hand_advance *hand, path_step *path, const creep_step *creep, tick_output *output, vec3 gradient);

#endif
