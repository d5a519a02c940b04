/* From body to body: a tip that has left the tissue on the far side either returns or enters the next body. */
#ifndef TROCAR_NEXT_BODY_H
#define TROCAR_NEXT_BODY_H

#include "insertion/state/tick_data.h"

/* Where the tip enters a body, and the obstacle there. */
typedef struct {
    bool found;
    int tet, face, blocked_by;
    vec3 point;              /* m, nominal */
} entrance;

/* Lets a tip that has left the tissue on the far side re-enter it, but only once the needle's end is more than one radius behind the exit point: tissue springs
   back as the tip leaves and would otherwise enclose the tip again. RT */
void reenter_tissue(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output);

/* Looks for more tissue ahead of a needle that has left the tissue on the far side. RT */
void enter_body_ahead(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output);

/* If the tip has left the tissue in this tick, lets it enter a body that lies between the nominal exit point and the tip's position in space. It may do so in
   the same tick, because bodies that touch have the same displacement. RT */
void enter_touching_body(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);

/* Finds where the segment from the exit point `left` to `to` enters the next body. Separately meshed bodies may overlap; the tip is then in the next body as
   soon as it leaves the first. RT */
entrance next_body(const tick_input *tick, const insertion_state *state, vec3 left, vec3 to);

/* Enters the next body, `gap` (m) beyond the exit. If there is no room to record the gap, the needle goes on without contact. RT */
void enter_next(const tick_input *tick, insertion_state *state, tick_output *output, const entrance *at, double gap);

/* Returns the direction in which the tip cuts: along the needle, tilted away from the bevel face. Not normalised. RT */
vec3 needle_direction(const tick_input *tick, const insertion_state *state);

#endif
