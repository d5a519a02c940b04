/* The contact nodes along the track: planned ahead of the tip, left behind as it cuts, and removed as it is drawn back. */
#ifndef TROCAR_CONTACT_NODES_H
#define TROCAR_CONTACT_NODES_H

#include "insertion/state/tick.h"

/* Depth of the last contact that the tip has passed, m; -INFINITY if there is none. RT */
double last_contact_depth(const insertion_state *state);

/* Plans the contact node of an element that the tip enters: halfway along its chord (or at the exit point, if the scene says so). On a long chord, the node is
   in the middle of the first share. The node is at least `spacing` from the last one. Its row of the inverse is requested now, so that it arrives before the
   tip. RT */
void plan_contact(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);

/* Plans the next contact node in an element with a long chord, in which the tip has just left one. RT */
void plan_another(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);
void drop_plan(insertion_state *state); /* RT */

/* Plans a last contact where the tip leaves the tissue, if the previous one is far enough away. `left`: distance to the exit along the unit direction `way`,
   m. RT */
bool wants_contact_at_exit(const tick_input *tick, const insertion_state *state, double depth);
void plan_exit(const tick_input *tick, insertion_state *state, tick_output *output, vec3 way, double left);

/* Sets the mesh's resolution at a contact. RT */
void set_resolution(const insertion_model *model, shaft_contact *contact, const resolved_field *resolved);

/* Leaves a contact node at the tip: the planned one, or a new one if the tip passes elsewhere. The contact becomes active once the worker has its row. RT */
void place_contact(const tick_input *tick, insertion_state *state, tick_output *output);

/* Removes the last contact, to which the tip has returned; the tip takes over its state. RT */
void return_to_contact(const tick_input *tick, insertion_state *state, tick_output *output);

/* Sets the tip's offset outside an outer face; zero if there is none. RT */
void set_beside(needle_tip *tip, vec3 beside);

#endif
