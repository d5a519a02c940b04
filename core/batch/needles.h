/* A step of a simulation that drives several needles. */
#ifndef TROCAR_BATCH_NEEDLES_H
#define TROCAR_BATCH_NEEDLES_H

#include "api/api.h"

/* BAD_INPUT if the model has only a mesh, or fewer needles than are driven. */
trocar_status check_driven_needles(const trocar_model *model, int needles, report *why);

/* Ticks needles 0 to `needles` - 1, one after another, with their bases at `poses`, [needles]. A needle that rests is not ticked: its pose is not read, and its
   force, torque and events are 0. If a tick fails, the needles before it have been ticked. */
trocar_status step_needles(trocar_sim *sim, int needles, const trocar_pose *poses, double dt, trocar_output *outputs, report *why);

#endif
