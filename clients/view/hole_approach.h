/* Takes a needle to a hole of a template: the pose in which it waits in front of it, and the way there. No threads, no clock. */
#ifndef TROCAR_HOLE_APPROACH_H
#define TROCAR_HOLE_APPROACH_H

#include <stdbool.h>

#include "rate_control.h"
#include "template_holes.h"

/* In line with a hole, with the tip a little in front of the face where needles enter. Its y is along the rows.
   `column` and `row` from 0; one half more is between two holes. */
pose hole_home(const trocar_guide *guide, double column, double row, double needle_length);

/* The same of the hole that is closest to a needle's base. */
pose hole_home_beside(const trocar_guide *guide, pose base, double needle_length);

/* Whether base and tip are on the axis of the hole in front of which `home` is, within half a millimetre. */
bool in_line_with_hole(pose home, pose base, double needle_length);

/* Advances the base by dt (s) towards `d->home`: first back along its axis until the tip is out of the template, then sideways. At twice
   the speed of rate control, because the needle is outside of the tissue. Returns true when it has arrived. */
bool approach_step(rate_control_state *d, const rate_control_limits *limits, double dt);

#endif
