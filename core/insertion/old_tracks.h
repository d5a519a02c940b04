/* Old tracks: tissue that was cut stays cut. A tip that goes down a track is led along it, without cutting, and passes its punctures. See
   README.md, "Old tracks". */
#ifndef TROCAR_OLD_TRACKS_H
#define TROCAR_OLD_TRACKS_H

#include "insertion/tick.h"

/* Looks for an open track ahead of the tip, which would cut along scratch.aim: sets tip.open and what belongs to it, and tip.torn. RT */
void old_tracks_find(const tick_context *tick);

/* Would the slip of this solve take the tip past the end of the track? RT */
bool old_tracks_overrun(const needle_tip *tip);

/* The track that the tip follows has ended, until the tip moves: another one is ahead, or whole tissue. RT */
void old_tracks_end(const tick_context *tick);

/* The direction in which the tip goes in place of the one in which it would cut. RT */
vec3 old_tracks_lead(const needle_tip *tip, vec3 direction);

/* Bound of the tip's force along the needle for moving on, N: `resistance`, and what it takes to be led sideways. RT */
double old_tracks_bound(const needle_tip *tip, vec3 needle, double resistance);

/* Records what the tip has cut since it was at `from`, in element `tet`. RT */
void old_tracks_cut(const tick_context *tick, int tet, vec3 from);

/* Records that the tip has punctured a membrane where it is. RT */
void old_tracks_puncture(const tick_context *tick, int membrane);

/* How far a membrane has been torn at this nominal point by punctures beside it, 0 to 1; 0 for what is no membrane. RT */
double old_tracks_torn(const tick_context *tick, int blocked_by, vec3 x);

/* What blocks a tip that comes to this nominal point of a face, as obstacle(): not a membrane that is open there. RT */
int old_tracks_obstacle(const tick_context *tick, int tet, int face, int behind, vec3 x);

#endif
