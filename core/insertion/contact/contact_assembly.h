/* Puts the contact problem together: what the points of contact are, how tissue, needle and mount yield between them, which
   forces they can bear, and the gaps that would be open without forces. */
#ifndef TROCAR_CONTACT_ASSEMBLY_H
#define TROCAR_CONTACT_ASSEMBLY_H

#include "insertion/state/tick.h"

/* Lists the points of contact: with guides, the active contacts, and with points->tip the tip. RT */
void points_list(const tick_input *tick, const insertion_state *state, contact_points *points);

/* Where they are on the needle, and in holes and tissue that the needle exerts no force on. RT */
void points_locate(const tick_input *tick, const insertion_state *state, contact_points *points, const tissue_step *tissue, const creep_step *creep, hole_edge *edges);

/* Forces of the points on the needle's joints. RT */
void points_load_needle(const tick_input *tick, const insertion_state *state, const contact_points *points, needle_response *response);

/* Compliance of the tissue between the tip, whose corners have these handles, and each point; the free displacement at the tip. RT */
void find_tip_rows(const tick_input *tick, const insertion_state *state, const contact_points *points, tissue_step *tissue, const creep_step *creep,
                   const int handles[4]);

/* Keeps the shear of the tissue along each share as the share comes to lie in other regions. RT */
void keep_shear(const tick_input *tick, insertion_state *state, contact_points *points, const creep_step *creep);

/* Local compliances of the points, m/N. Shaft: by its share of length in each region. Tip: sideways as shaft of its share and
   one radius more (its hold fades out at the surface unless it is pressed in); along the needle as a disc under the cutting force,
   beside the shaft next to it. RT */
void find_local_compliance(const tick_input *tick, const insertion_state *state, const contact_points *points, tissue_step *tissue);

/* Bounds of the forces along the needle. RT */
void bound_contacts(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, resistance_ahead *ahead,
                    hole_edge *edges, contact_problem *problem);

/* Compliance of tissue, needle and mount between all points, in their frames; local compliance on the diagonal. RT */
void assemble_compliance(const tick_input *tick, const insertion_state *state, insertion_workspace *w);

/* The gaps that would be open without contact forces. RT */
void assemble_gaps(const tick_input *tick, const insertion_state *state, insertion_workspace *w);

#endif
