/* The tip: touching the tissue, cutting, obstacles and punctures, sliding on the surface. */
#ifndef TROCAR_TIP_H
#define TROCAR_TIP_H

#include "insertion/state/tick_data.h"

/* Starts an insertion where the segment from `from` to `to` crosses the outer surface. Returns false if it does not. The track begins in the needle's
   direction, however the tip got there. RT */
bool tip_touch(const tick_input *tick, insertion_state *state, tick_output *output, vec3 from, vec3 to);

/* True if the segment enters the nominal body and ends inside it. RT */
bool tip_is_below(const insertion_model *model, vec3 from, vec3 to);

/* Applies the slip of the last solve: cuts forward along the needle's direction, or goes back along the track. If the tip leaves the tissue on the far side, it
   enters whatever tissue the needle's end meets next. `cut_direction`: unit direction, in the undeformed tissue, in which the tip would cut. RT */
void tip_move(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, vec3 cut_direction);

/* Returns the unit direction, in the undeformed tissue, in which the tip would cut if no old track guided it. `track_gradient`: derivative of the tissue's
   displacement along the track, at the tip. RT */
vec3 tip_cut_direction(const tick_input *tick, const insertion_state *state, vec3 track_gradient);

/* Slides a tip that is on the surface and has not entered the tissue yet. Coulomb friction holds it as long as the force on the skin is within a cone about the
   surface's normal; otherwise it slides along the surface. RT */
void tip_glide_on_surface(const tick_input *tick, insertion_state *state, tick_output *output);

/* Punctures a membrane if the last solve exceeded its strength. RT */
void tip_puncture(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output);

/* Sets the state of a straight needle that overlaps the tissue, as if it had been inserted without force. RT */
void tip_engage(const insertion_model *model, insertion_state *state);

#endif
