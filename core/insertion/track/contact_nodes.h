/* The contact nodes along the track: planned ahead of the tip, left behind as it cuts, taken up again as it is drawn back. */
#ifndef TROCAR_CONTACT_NODES_H
#define TROCAR_CONTACT_NODES_H

#include "insertion/state/tick.h"

/* Depth of the last one that the tip has passed, m; -INFINITY without one. RT */
double last_contact_depth(const insertion_state *state);

/* On entering an element: its contact node is due half way through it (or where the tip leaves it, as the scene says), or, where that is
   a long way, in the middle of its first share, but not closer to the last one than the spacing. Requested now, its row of the inverse is there when the tip is. RT */
void plan_contact(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);

/* The next one in the same element, which the tip has just left one in, if its way through it is long. RT */
void plan_another(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);
void drop_plan(insertion_state *state); /* RT */

/* Where the tip goes out of the tissue, it leaves one more contact if the last one is far enough away: planned ahead as well. `left`: m to
   the exit along the unit direction `way`. RT */
bool wants_contact_at_exit(const tick_input *tick, const insertion_state *state, double depth);
void plan_exit(const tick_input *tick, insertion_state *state, tick_output *output, vec3 way, double left);

/* What the mesh resolves at a contact. RT */
void set_resolution(const insertion_model *model, shaft_contact *contact, const resolved_field *resolved);

/* Leaves a contact node at the tip: the planned one, or a new one if the tip came elsewhere. It takes part as soon as the worker
   has its row. RT */
void place_contact(const tick_input *tick, insertion_state *state, tick_output *output);

/* The tip has come back to its last contact node and takes its place. RT */
void return_to_contact(const tick_input *tick, insertion_state *state, tick_output *output);

/* Sets how far the tip is out of an outer face; zero: it is not. RT */
void set_beside(needle_tip *tip, vec3 beside);

#endif
