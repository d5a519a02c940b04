/* Converts the simulation's results to messages. */
#ifndef TROCAR_MESSAGES_H
#define TROCAR_MESSAGES_H

#include "base/vec.h"
#include "trocar.h"
#include "trocar_needle_wrench_t.h"

/* Converts a tick's output to a message and sets the flags that the output's events imply. Copies both the raw and the rendered wrench from the
   output. The caller sets tick, pose and time. RT */
trocar_needle_wrench_t wrench_message(const trocar_output *output);

void store_vec3(vec3 v, double out[3]); /* RT */
vec3 load_vec3(const double v[3]);      /* RT */
pose load_pose(const double position[3], const double orientation[4]); /* position in m; quaternion as w, x, y, z; the values are copied unchanged. RT */
trocar_pose library_pose(pose p);       /* Converts a pose to the pose type of trocar.h. RT */

#endif
