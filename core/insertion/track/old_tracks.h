/* Old tracks: cut tissue stays cut. An old track guides the tip, which does not cut along it and can pass through its punctures. See docs/mechanics.md,
   "Old tracks". */
#ifndef TROCAR_OLD_TRACKS_H
#define TROCAR_OLD_TRACKS_H

#include "insertion/state/tick_data.h"

/* Among the tracks that end more than `beyond` (m) ahead of the tip, returns the most open one for a tip that would cut along path->cut_direction; the
   closest one if several are equally open. RT */
open_track old_tracks_ahead(const tick_input *tick, const insertion_state *state, const path_step *path, double beyond);

/* Direction of a tip that follows this track and would otherwise cut along `direction`. RT */
vec3 old_tracks_lead(const open_track *track, vec3 direction);

/* Force (N) along the needle at which the tip advances: `resistance` plus the force needed to guide the tip sideways. RT */
double old_tracks_bound(const open_track *track, vec3 tip_force, vec3 needle, double resistance);

/* Records that the tip has cut from `from`, in element `tet`, to its current position. RT */
void old_tracks_cut(insertion_state *state, tick_output *output, int tet, vec3 from);

/* Records that the tip has punctured a membrane at its current position. RT */
void old_tracks_puncture(insertion_state *state, tick_output *output, int membrane);

/* Damage (0 to 1) of a membrane at this nominal point, caused by punctures near it; 0 if `blocked_by` is not a membrane. RT */
double old_tracks_damage(const tick_input *tick, const insertion_state *state, int blocked_by, vec3 x);

/* Returns the obstacle for a tip at this nominal point of a face, in the same way as obstacle(), but ignores a membrane that is open at this point. RT */
int old_tracks_obstacle(const tick_input *tick, const insertion_state *state, int tet, int face, int behind, vec3 x);

#endif
