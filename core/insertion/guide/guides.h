/* Contact points between the needle and the guides it passes through. See docs/mechanics.md, "Guides". */
#ifndef TROCAR_GUIDES_H
#define TROCAR_GUIDES_H

#include "insertion/state/tick_data.h"

/* After the tip has moved, records for each guide which hole the needle is in, or that it misses the plate. RT */
void guides_follow(const tick_input *tick, insertion_state *state, tick_output *output);

/* Slides the shaft through the holes by the slips of the last solve. RT */
void guides_slide(const insertion_model *model, insertion_state *state);

/* True if the needle is in a hole of any guide, which means that it can bend outside the tissue. RT */
bool guides_hold(const insertion_model *model, const insertion_state *state);

/* Lists the guides' contact points, which come first in the list. RT */
void guides_list(const tick_input *tick, const insertion_state *state, contact_points *points);

/* Finds where the guide points are on the needle and on the holes' edges, and the compliance of the edges. RT */
void guides_locate(const tick_input *tick, const insertion_state *state, contact_points *points, hole_edge *edges);

/* Bounds the force along the needle by Coulomb friction, given the normal force of the last pass. RT */
void guides_bound(const tick_input *tick, const insertion_state *state, const contact_points *points, hole_edge *edges, contact_problem *problem, int point);

/* True if the needle does not touch the edge at this point, which is then decoupled and bears no force. RT */
static inline bool guides_is_open(const contact_points *points, const hole_edge *edges, int point) { return point < points->guided && !edges[point].touched; }

/* Adds the edge's compliance to the contact problem. RT */
void guides_add_compliance(const tick_input *tick, const contact_points *points, const hole_edge *edges, contact_problem *problem, int point);
void guides_close_gap(const hole_edge *edges, contact_problem *problem, int point);

/* Copies the point's slip from the solution. RT */
void guides_take(insertion_state *state, const contact_points *points, const hole_edge *edges, const contact_problem *problem, int point);

/* True if the needle's position in the holes agrees with the edge forces of the last pass. RT */
bool guides_agree(const contact_points *points, const hole_edge *edges);

#endif
