/* The guides that the needle passes through, as points of contact: see docs/mechanics.md, "Guides". */
#ifndef TROCAR_GUIDES_H
#define TROCAR_GUIDES_H

#include "insertion/state/tick.h"

/* Puts the needle through the holes that it lies in, or past the plates that it misses, after the tip has moved. RT */
void guides_follow(const tick_input *tick, insertion_state *state, tick_output *output);

/* The shaft slides through the holes by the slip of the last solve. RT */
void guides_slide(const insertion_model *model, insertion_state *state);

/* Is the needle in a hole? Then it may be bent in the air. RT */
bool guides_hold(const insertion_model *model, const insertion_state *state);

/* Lists the points of contact with guides, which come before all others. RT */
void guides_list(const tick_input *tick, const insertion_state *state, contact_points *points);

/* Where the edges of the holes would have these points, located on the needle, without force; how the edges yield. RT */
void guides_locate(const tick_input *tick, const insertion_state *state, contact_points *points, hole_edge *edges);

/* Bounds of its force along the needle: Coulomb friction, of the normal force in the last pass. RT */
void guides_bound(const tick_input *tick, const insertion_state *state, const contact_points *points, hole_edge *edges, contact_problem *problem, int point);

/* Is this point at a hole whose edge the needle does not touch? It is not coupled to the others, and bears no force. RT */
static inline bool guides_is_open(const contact_points *points, const hole_edge *edges, int point) { return point < points->guided && !edges[point].touched; }

/* Adds the edge's compliance to the contact problem. RT */
void guides_add_compliance(const tick_input *tick, const contact_points *points, const hole_edge *edges, contact_problem *problem, int point);
void guides_close_gap(const hole_edge *edges, contact_problem *problem, int point);

/* Takes its slip from the solution. RT */
void guides_take(insertion_state *state, const contact_points *points, const hole_edge *edges, const contact_problem *problem, int point);

/* Is the needle where the holes' edges bear the forces of the last pass? RT */
bool guides_agree(const contact_points *points, const hole_edge *edges);

#endif
