/* The tip's way through the nominal mesh: touching, cutting, being stopped by membranes, drawing back; the contact
   nodes that it leaves behind and takes up again. */
#ifndef TROCAR_TIP_H
#define TROCAR_TIP_H

#include "insertion/insertion.h"

/* Contact nodes that the tip has passed: all but a planned one. RT */
static inline int contacts_passed(const insertion_state *state) { return state->refined.count - state->tip.planned; }

/* Depth at which the track entered the body that the tip is in, m: 0 in the first one. RT */
double tip_entry_depth(const insertion_state *state);

/* Starts an insertion where the outer surface lies between `from` and `to`; false if it does not. RT */
bool tip_touch(const insertion_model *model, insertion_state *state, vec3 from, vec3 to, insertion_wrench *wrench);

/* Does the segment enter the nominal body, and lie in it from there to its end? RT */
bool tip_is_below(const insertion_model *model, vec3 from, vec3 to);

/* Carries out the slip of the last solve: forward along the needle's direction (cutting), back along the track. A tip that has
   left the tissue on the far side is followed into whatever tissue the needle's end meets next.
   `track_gradient` is the derivative of the tissue's displacement along the track, about the tip. RT */
void tip_move(const insertion_model *model, insertion_state *state, vec3 track_gradient, insertion_wrench *wrench);

/* Moves the tip's material point along the outer surface by `shift`, m, tangential to it. `inward` is the surface's unit normal. RT */
void tip_glide(const insertion_model *model, insertion_state *state, vec3 inward, vec3 shift, insertion_wrench *wrench);

/* Lets a membrane give way that was overcome in the last solve. RT */
void tip_puncture(const insertion_model *model, insertion_state *state, insertion_wrench *wrench);

/* Resistance of what is ahead of the tip, N (cutting or puncture). RT */
double tip_resistance(const insertion_model *model, const needle_tip *tip);

/* Puts a straight needle that lies in the tissue into the state of having been inserted without force. RT */
void tip_engage(const insertion_model *model, insertion_state *state);

#endif
