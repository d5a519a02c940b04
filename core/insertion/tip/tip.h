/* The tip: touching the tissue, cutting, being stopped and let through, gliding on the surface. */
#ifndef TROCAR_TIP_H
#define TROCAR_TIP_H

#include "insertion/state/tick.h"

/* Starts an insertion where the outer surface lies between `from` and `to`; false if it does not. RT */
bool tip_touch(const tick_input *tick, insertion_state *state, tick_output *output, vec3 from, vec3 to);

/* Does the segment enter the nominal body, and lie in it from there to its end? RT */
bool tip_is_below(const insertion_model *model, vec3 from, vec3 to);

/* Carries out the slip of the last solve: forward along the needle's direction (cutting), back along the track. A tip that has
   left the tissue on the far side is followed into whatever tissue the needle's end meets next.
   `aim` is the unit nominal direction in which the tip would cut. RT */
void tip_move(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, vec3 aim);

/* Unit nominal direction in which the tip would cut, were it not led along an old track. `track_gradient` is the derivative of the tissue's displacement
   along the track, at the tip. RT */
vec3 tip_cut_direction(const tick_input *tick, const insertion_state *state, vec3 track_gradient);

/* On the surface, before it is in, the tip sticks by Coulomb friction: the force on the skin stays within a cone about the
   surface's normal. Outside the cone the tip slides along the surface. RT */
void tip_glide_on_surface(const tick_input *tick, insertion_state *state, tick_output *output);

/* Lets a membrane give way that was overcome in the last solve. RT */
void tip_puncture(const tick_input *tick, insertion_state *state, tick_output *output);

/* Puts a straight needle that lies in the tissue into the state of having been inserted without force. RT */
void tip_engage(const insertion_model *model, insertion_state *state);

#endif
