/* Transition between bodies: a tip that has left the tissue on the far side either returns or enters the next body. */
#ifndef TROCAR_NEXT_BODY_H
#define TROCAR_NEXT_BODY_H

#include "insertion/state/tick_data.h"

/* Where the tip enters a body: a point of the mesh, and the obstacle at this point. */
typedef struct {
    bool found;
    int tet, face, blocked_by;
    vec3 point;              /* m, nominal */
} entrance;

/* Lets a tip that has left the tissue on the far side re-enter it if the needle's end is more than one radius behind the exit point. At a smaller distance,
   tissue that springs back when the tip leaves would enclose the tip again. RT */
void reenter_tissue(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output);

/* Looks for other tissue ahead of a needle that has left the tissue on the far side. RT */
void enter_body_ahead(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output);

/* If the tip has left the tissue in this tick, lets it enter a body that lies between the nominal exit point and the tip's position in space. It enters in the
   same tick, because touching bodies have the same displacement. RT */
void enter_touching_body(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);

/* Finds where the segment from the tip's exit point `left` to `to` enters the next body. Separately meshed bodies may overlap; the tip is then in the next
   body as soon as it leaves the first. RT */
entrance next_body(const tick_input *tick, const insertion_state *state, vec3 left, vec3 to);

/* Enters the next body, `gap` (m) beyond the exit. If there is no room to record the gap, the needle advances without contact. RT */
void enter_next(const tick_input *tick, insertion_state *state, tick_output *output, const entrance *at, double gap);

/* Cutting direction of the tip: along the needle, plus a lateral component directed away from the bevel face. RT */
vec3 needle_direction(const tick_input *tick, const insertion_state *state);

#endif
