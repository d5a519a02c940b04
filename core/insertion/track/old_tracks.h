/* Old tracks: cut tissue stays cut. A tip in an old track is guided along it without cutting, and passes its punctures. See docs/mechanics.md, "Old tracks". */
#ifndef TROCAR_OLD_TRACKS_H
#define TROCAR_OLD_TRACKS_H

#include "insertion/state/tick.h"

/* The most open track for a tip that would cut along path->cut_direction, among the tracks that end more than `beyond` (m) ahead of it; the closest one if
   several are equally open. RT */
open_track old_tracks_ahead(const tick_input *tick, const insertion_state *state, const path_step *path, double beyond);

/* Direction of a tip that follows this track, where it would otherwise cut along `direction`. RT */
vec3 old_tracks_lead(const open_track *track, vec3 direction);

/* Bound of the tip's force along the needle for advancing, N: `resistance` plus the force needed to guide it sideways. RT */
double old_tracks_bound(const open_track *track, vec3 tip_force, vec3 needle, double resistance);

/* Records the tip's cut from `from`, in element `tet`, to its present position. RT */
void old_tracks_cut(insertion_state *state, tick_output *output, int tet, vec3 from);

/* Records that the tip has punctured a membrane at its present position. RT */
void old_tracks_puncture(insertion_state *state, tick_output *output, int membrane);

/* Damage of a membrane at this nominal point by punctures beside it, 0 to 1; 0 if `blocked_by` is not a membrane. RT */
double old_tracks_damage(const tick_input *tick, const insertion_state *state, int blocked_by, vec3 x);

/* The obstacle for a tip at this nominal point of a face, as obstacle() returns it, except for a membrane that is open there. RT */
int old_tracks_obstacle(const tick_input *tick, const insertion_state *state, int tet, int face, int behind, vec3 x);

#endif
