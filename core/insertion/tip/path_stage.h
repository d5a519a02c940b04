/* The path stage: moves the tip through the undeformed tissue by the slip of the last solve, or lets it touch the surface. Also finds open tracks ahead of it
   and the guide holes that the needle is in. */
#ifndef TROCAR_PATH_STAGE_H
#define TROCAR_PATH_STAGE_H

#include "insertion/state/tick_data.h"

/* Runs the path stage. `gradient`: derivative of the tissue's displacement along the track, before the hand moved (track_gradient.h). RT */
void path_follow(const tick_input *tick, insertion_state *state, const hand_advance *hand, path_step *path, const creep_step *creep, tick_output *output, vec3 gradient);

#endif
