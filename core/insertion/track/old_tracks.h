/* Old tracks: tissue that was cut stays cut. A tip that goes down a track is led along it, without cutting, and passes its punctures. See
   docs/mechanics.md, "Old tracks". */
#ifndef TROCAR_OLD_TRACKS_H
#define TROCAR_OLD_TRACKS_H

#include "insertion/state/tick.h"

/* The track that is most open to the tip, which would cut along path->cut_direction, among those that end more than `beyond` (m) ahead of it; the closest of
   several. RT */
open_track old_tracks_ahead(const tick_input *tick, const insertion_state *state, const path_step *path, double beyond);

/* The direction in which the tip goes along this track in place of the one in which it would cut. RT */
vec3 old_tracks_lead(const open_track *track, vec3 direction);

/* Bound of the tip's force along the needle for moving on, N: `resistance`, and what it takes to be led sideways. RT */
double old_tracks_bound(const open_track *track, vec3 tip_force, vec3 needle, double resistance);

/* Records what the tip has cut since it was at `from`, in element `tet`. RT */
void old_tracks_cut(insertion_state *state, tick_output *output, int tet, vec3 from);

/* Records that the tip has punctured a membrane where it is. RT */
void old_tracks_puncture(insertion_state *state, tick_output *output, int membrane);

/* How far a membrane has been torn at this nominal point by punctures beside it, 0 to 1; 0 for what is no membrane. RT */
double old_tracks_damage(const tick_input *tick, const insertion_state *state, int blocked_by, vec3 x);

/* What blocks a tip that comes to this nominal point of a face, as obstacle(): not a membrane that is open there. RT */
int old_tracks_obstacle(const tick_input *tick, const insertion_state *state, int tet, int face, int behind, vec3 x);

#endif
