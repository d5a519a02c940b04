/* Moves a needle to a hole of a template: where it waits in front of the hole, and how it gets there. Uses no threads and no clock. */
#ifndef TROCAR_HOLE_APPROACH_H
#define TROCAR_HOLE_APPROACH_H

#include <stdbool.h>

#include "shared/rate_control.h"
#include "shared/template_holes.h"

/* Returns the pose in which a needle waits at a hole: aligned with the hole, the tip a little in front of the face at which needles enter, the y axis along the
   rows. `column` and `row` count from 0, and may lie halfway between two holes. */
pose hole_home(const trocar_guide *guide, double column, double row, double needle_length);

/* Returns the waiting pose at the hole nearest to the needle's base. */
pose hole_home_beside(const trocar_guide *guide, pose base, double needle_length);

/* True if base and tip are within half a millimetre of the axis of the hole at which `home` is the waiting pose. */
bool in_line_with_hole(pose home, pose base, double needle_length);

/* Advances the base by dt (s) towards `d->home`: first back along its axis until the tip is out of the template, then sideways. Goes twice as fast as rate
   control does, because the needle is outside the tissue. Returns true once it has arrived. */
bool approach_step(rate_control_state *d, const rate_control_limits *limits, double dt);

#endif
