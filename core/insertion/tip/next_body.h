/* From body to body: a tip that has left the tissue on the far side comes back, or meets tissue again. */
#ifndef TROCAR_NEXT_BODY_H
#define TROCAR_NEXT_BODY_H

#include "insertion/state/tick.h"

/* Where the tip enters a body: a point of the mesh, and what blocks it there. */
typedef struct {
    bool found;
    int tet, face, blocked_by;
    vec3 point;              /* m, nominal */
} entrance;

/* After leaving on the far side: the tip is back when the needle's end is more than a radius behind the exit point. At a smaller
   distance, tissue that springs back as the tip lets go of it would take the tip in again. RT */
void reenter_tissue(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output);

/* The end of a needle that is out on the far side may meet other tissue as it goes on. RT */
void enter_body_ahead(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output);

/* The tip has left the tissue in this tick. Bodies that touch pass on their displacement: what lies between the nominal
   point where the tip left and its place in space is entered at once. RT */
void enter_touching_body(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);

/* Where the segment from `left`, at which the tip left a body, to `to` enters the next one. Bodies that were meshed separately may
   overlap: then the tip is in the next one as it leaves the first. RT */
entrance next_body(const tick_input *tick, const insertion_state *state, vec3 left, vec3 to);

/* Enters the next body, `gap` (m) after the exit. If there is no room to record that, the needle goes on unfelt. RT */
void enter_next(const tick_input *tick, insertion_state *state, tick_output *output, const entrance *at, double gap);

/* Where the tip cuts to: along the needle, and sideways away from the bevel's face. RT */
vec3 needle_direction(const tick_input *tick, const insertion_state *state);

#endif
