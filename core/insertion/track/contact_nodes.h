/* The contact nodes along the track. They are planned ahead of the tip, left behind as it cuts, and removed as it is drawn back. */
#ifndef TROCAR_CONTACT_NODES_H
#define TROCAR_CONTACT_NODES_H

#include "insertion/state/tick_data.h"

/* Returns the depth (m) of the last contact that the tip has passed; -INFINITY if there is none. RT */
double last_contact_depth(const insertion_state *state);

/* Plans a contact node in the element that the tip enters, in the middle of its chord; a long chord is divided into equal parts, and the node is in the middle
   of the first. It is at least `contact_spacing` from the previous node. Its row of the inverse is requested right away, so that the row arrives before the tip
   does. RT */
void plan_contact(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);

/* Plans the next contact node in an element with a long chord, after the tip has left one there. RT */
void plan_another(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);
void drop_plan(insertion_state *state); /* RT */

/* wants_contact_at_exit: true if an exit at this depth (m) is far enough from the previous contact. plan_exit: if so, plans a last contact where the tip leaves
   the tissue. `left`: distance (m) to the exit along the unit direction `way`. RT */
bool wants_contact_at_exit(const tick_input *tick, const insertion_state *state, double depth);
void plan_exit(const tick_input *tick, insertion_state *state, tick_output *output, vec3 way, double left);

/* Sets the mesh's resolution at a contact. RT */
void set_resolution(const insertion_model *model, shaft_contact *contact, const resolved_field *resolved);

/* Leaves a contact node at the tip: the planned one, or a new one if the tip passes too far beside it. The contact becomes active when the worker has supplied
   its row of the inverse. RT */
void place_contact(const tick_input *tick, insertion_state *state, tick_output *output);

/* Removes the last contact when the tip has come back to it. The tip takes over its state. RT */
void return_to_contact(const tick_input *tick, insertion_state *state, tick_output *output);

/* Sets the tip's offset from an outer face that it is outside of; zero if it is not outside. RT */
void set_beside(needle_tip *tip, vec3 beside);

#endif
