/* The tip: touching the tissue, cutting, obstacles and punctures, sliding on the surface. */
#ifndef TROCAR_TIP_H
#define TROCAR_TIP_H

#include "insertion/state/tick.h"

/* Starts an insertion where the segment from `from` to `to` crosses the outer surface; returns false if it does not. RT */
bool tip_touch(const tick_input *tick, insertion_state *state, tick_output *output, vec3 from, vec3 to);

/* True if the segment enters the nominal body and stays in it up to its end. RT */
bool tip_is_below(const insertion_model *model, vec3 from, vec3 to);

/* Applies the slip of the last solve: forward along the needle's direction (cutting), or back along the track. A tip that has left the tissue on the far side
   enters any tissue that the needle's end meets next. `cut_direction` is the unit nominal direction in which the tip would cut. RT */
void tip_move(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, vec3 cut_direction);

/* Unit nominal direction in which the tip would cut if no old track guided it. `track_gradient` is the derivative of the tissue's displacement along the
   track, at the tip. RT */
vec3 tip_cut_direction(const tick_input *tick, const insertion_state *state, vec3 track_gradient);

/* On the surface, before it enters, the tip sticks by Coulomb friction: the force on the skin stays within a cone about the surface's normal. Outside the cone
   the tip slides along the surface. RT */
void tip_glide_on_surface(const tick_input *tick, insertion_state *state, tick_output *output);

/* Punctures a membrane whose limit was exceeded in the last solve. RT */
void tip_puncture(const tick_input *tick, insertion_state *state, tick_output *output);

/* Sets the state of a straight needle that overlaps the tissue as if the needle had been inserted without force. RT */
void tip_engage(const insertion_model *model, insertion_state *state);

#endif
