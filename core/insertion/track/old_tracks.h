/* Old tracks: cut tissue stays cut. A tip follows an old track without cutting, and passes through its punctures. See docs/mechanics.md, "Old tracks". */
#ifndef TROCAR_OLD_TRACKS_H
#define TROCAR_OLD_TRACKS_H

#include "insertion/state/tick_data.h"

/* Among the tracks that end more than `beyond` (m) ahead of the tip, returns the most open one for a tip that would cut along path->cut_direction. If several
   are equally open, returns the closest. RT */
open_track old_tracks_ahead(const tick_input *tick, const insertion_state *state, const path_step *path, double beyond);

/* Returns the direction in which this track leads a tip that would otherwise cut along `direction`. RT */
vec3 old_tracks_lead(const open_track *track, vec3 direction);

/* Returns the force (N) along the needle at which the tip advances: `resistance` plus what it takes to guide the tip sideways. RT */
double old_tracks_bound(const open_track *track, vec3 tip_force, vec3 needle, double resistance);

/* Records that the tip has cut from `from`, in element `tet`, to where it is now. RT */
void old_tracks_cut(insertion_state *state, tick_output *output, int tet, vec3 from);

/* Records that the tip has punctured a membrane where it is now. RT */
void old_tracks_puncture(insertion_state *state, tick_output *output, int membrane);

/* Returns the damage (0 to 1) of a membrane at this nominal point due to punctures near it; 0 if `blocked_by` is not a membrane. RT */
double old_tracks_damage(const tick_input *tick, const insertion_state *state, int blocked_by, vec3 x);

/* Returns the obstacle to a tip at this nominal point of a face, like obstacle(), but ignores a membrane that is fully open there. RT */
int old_tracks_obstacle(const tick_input *tick, const insertion_state *state, int tet, int face, int behind, vec3 x);

#endif
