/* Frames on the needle's centreline, four points at a time. */
#ifndef TROCAR_CENTRELINE_KERNELS_H
#define TROCAR_CENTRELINE_KERNELS_H

#include "needle/needle_model.h"

enum { CENTRELINE_STEP = 4 }; /* points at a time */

/* Sets the frames of the first `count` points. Each tangent is interpolated by rotation: `fraction` of the way from the axis of segment `before` to that of
   segment `after`. The second normal is near that segment's y axis. RT */
void centreline_frames(const quat *segments, const int before[CENTRELINE_STEP], const int after[CENTRELINE_STEP], const double fraction[CENTRELINE_STEP],
                       int count, needle_point *const *points);

#endif
