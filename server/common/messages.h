/* Converts results of the simulation to messages. */
#ifndef TROCAR_MESSAGES_H
#define TROCAR_MESSAGES_H

#include "base/vec.h"
#include "trocar.h"
#include "trocar_needle_wrench_t.h"

/* Converts a tick's output to a message and sets the flags that its events imply. Both the raw and the rendered wrench are set to the output's wrench. The
   caller fills in tick, pose and time. RT */
trocar_needle_wrench_t wrench_message(const trocar_output *output);

void store_vec3(vec3 v, double out[3]); /* RT */
vec3 load_vec3(const double v[3]);      /* RT */
pose load_pose(const double position[3], const double orientation[4]); /* m; w, x, y, z. Does not check or normalise. RT */
trocar_pose library_pose(pose p);       /* Converts to the pose type of trocar.h. RT */

#endif
