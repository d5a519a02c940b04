/* The contact nodes along the track: they are planned ahead of the tip, left behind as it cuts, and removed as it is drawn back. */
#ifndef TROCAR_CONTACT_NODES_H
#define TROCAR_CONTACT_NODES_H

#include "insertion/state/tick_data.h"

/* Depth (m) of the last contact that the tip has passed; -INFINITY if there is none. RT */
double last_contact_depth(const insertion_state *state);

/* Plans the contact node of an element that the tip enters: halfway along its chord; a long chord is divided into equal parts, and the node is in the middle
   of the first one. The node is at least `contact_spacing` from the previous one. Its row of the inverse is requested now, so that the row arrives before the
   tip. RT */
void plan_contact(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);

/* Plans the next contact node in an element with a long chord, where the tip has just left a node behind. RT */
void plan_another(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);
void drop_plan(insertion_state *state); /* RT */

/* wants_contact_at_exit: true if the previous contact is far enough from an exit at this depth (m). plan_exit: if so, plans a last contact where the tip leaves
   the tissue; `left`: distance (m) to the exit along the unit direction `way`. RT */
bool wants_contact_at_exit(const tick_input *tick, const insertion_state *state, double depth);
void plan_exit(const tick_input *tick, insertion_state *state, tick_output *output, vec3 way, double left);

/* Sets the mesh's resolution at a contact. RT */
void set_resolution(const insertion_model *model, shaft_contact *contact, const resolved_field *resolved);

/* Leaves a contact node at the tip's position: the planned one, or a new one if the tip has passed beside it. The contact becomes active once the worker has
   supplied its row of the inverse. RT */
void place_contact(const tick_input *tick, insertion_state *state, tick_output *output);

/* Removes the last contact when the tip has returned to it; the tip takes over the contact's state. RT */
void return_to_contact(const tick_input *tick, insertion_state *state, tick_output *output);

/* Sets the offset by which the tip is outside an outer face; zero if it is not outside. RT */
void set_beside(needle_tip *tip, vec3 beside);

#endif
