/* Replays a recorded log: simulates its poses in lockstep, as trocar-replay does. If the recording has several needles, shows only the first, as needle 0. */
#ifndef TROCAR_PLAYBACK_H
#define TROCAR_PLAYBACK_H

#include "view/stream/timeline.h"

enum { PLAYBACK_HZ = 30 };  /* pictures per second of log time */

/* Simulates the poses of the log at `path` in `scene` and writes the result to `t`. A log that is truncated or still being written is played up to its last
   complete event; `cut` then says where that is. For a complete log, `cut` is empty. Returns BAD_INPUT as pose_log_read_to_cut does. */
trocar_status playback_run(const trocar_scene *scene, const char *path, timeline *t, trocar_error *cut, trocar_error *why);

/* Simulates up to the last pose at or before `at` (s; INFINITY for the end), but writes only the sample and the picture at that time. Also returns BAD_INPUT if
   the log ends before `at`. */
trocar_status playback_moment(const trocar_scene *scene, const char *path, double at, timeline *t, trocar_error *cut, trocar_error *why);

#endif
