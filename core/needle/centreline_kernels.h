/* Frames on the needle's centreline, four points at a time. */
#ifndef TROCAR_CENTRELINE_KERNELS_H
#define TROCAR_CENTRELINE_KERNELS_H

#include "needle/needle_model.h"

enum { CENTRELINE_STEP = 4 }; /* number of points computed at a time */

/* Sets the frames of the first `count` points. To get the tangent, the axis of segment `before` is rotated toward that of segment `after` by `fraction` of the
   angle between them. The second normal is near local y. RT */
void centreline_frames(const quat *segments, const int before[CENTRELINE_STEP], const int after[CENTRELINE_STEP], const double fraction[CENTRELINE_STEP],
                       int count, needle_point *const *points);

#endif
