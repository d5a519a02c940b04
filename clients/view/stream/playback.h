/* Replays a recorded log: simulates its poses in lockstep, like trocar-replay. Of a recording with several needles, only the first is shown, as
   needle 0. */
#ifndef TROCAR_PLAYBACK_H
#define TROCAR_PLAYBACK_H

#include "view/stream/timeline.h"

enum { PLAYBACK_HZ = 30 };  /* pictures per second of log time */

/* Simulates the poses of the log at `path` in `scene` and writes the result to `t`. A log that is truncated or still being
   written is played to its last complete event; `cut` then says where that is (empty for a complete log). BAD_INPUT as in
   pose_log_read_to_cut. */
trocar_status playback_run(const trocar_scene *scene, const char *path, timeline *t, trocar_error *cut, trocar_error *why);

/* Simulates up to the last pose at or before `at` (s; INFINITY: the end), but writes only one sample and one picture at that time.
   Also BAD_INPUT if the log ends before `at`. */
trocar_status playback_moment(const trocar_scene *scene, const char *path, double at, timeline *t, trocar_error *cut, trocar_error *why);

#endif
