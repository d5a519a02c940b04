/* A recorded log, run again: its poses go through the mechanics in lockstep, as in trocar-replay. */
#ifndef TROCAR_PLAYBACK_H
#define TROCAR_PLAYBACK_H

#include "timeline.h"

enum { PLAYBACK_HZ = 30 };  /* pictures a second of the log's time */

/* Plays the poses of the log at `path` in `scene` and brings what happens to `t`. A log that was cut short, or is still being
   written, is played to its last whole event, and `cut` says where that is (empty for a whole log). BAD_INPUT as
   pose_log_read_to_cut. */
trocar_status playback_run(const scene *scene, const char *path, timeline *t, report *cut, report *why);

/* Plays them to the last one not after `at` (s; INFINITY: the end) and brings that moment only, a sample and a picture, to
   `t`. BAD_INPUT also where the log ends before `at`. */
trocar_status playback_moment(const scene *scene, const char *path, double at, timeline *t, report *cut, report *why);

#endif
