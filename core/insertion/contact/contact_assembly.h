/* Assembles the contact problem: lists the contact points and finds the compliance of tissue, needle and mount between them, the bounds on their forces, and
   the gaps that would open if there were no forces. */
#ifndef TROCAR_CONTACT_ASSEMBLY_H
#define TROCAR_CONTACT_ASSEMBLY_H

#include "insertion/state/tick_data.h"

/* Lists the contact points: guides, active contacts and, if it is in the tissue (points->tip), the tip. RT */
void points_list(const tick_input *tick, const insertion_state *state, contact_points *points);

/* Finds where the points are on the needle, and where holes and tissue would be without the needle's forces. RT */
void points_locate(const tick_input *tick, const insertion_state *state, contact_points *points, const tissue_step *tissue, const creep_step *creep, hole_edge *edges);

/* Computes the forces that the contact points exert on the needle's joints. RT */
void points_load_needle(const tick_input *tick, const insertion_state *state, const contact_points *points, needle_response *response);

/* Computes the tissue's compliance between the tip and each point, and the displacement at the tip without the needle's current forces. `handles`: corners of
   the element that contains the tip. RT */
void find_tip_rows(const tick_input *tick, const insertion_state *state, const contact_points *points, tissue_step *tissue, const creep_step *creep,
                   const int handles[4]);

/* Applies a change in the moduli of the tissue around the shaft. The tissue keeps its shear strain, so the traction changes. `points` is scratch. RT */
void soften_shear(const tick_input *tick, insertion_state *state, contact_points *points);

/* When a share of the shaft extends into another region, keeps the traction along it unchanged, because the shaft has not sheared the tissue there yet. RT */
void keep_shear(const tick_input *tick, insertion_state *state, contact_points *points, const creep_step *creep);

/* Computes the points' local compliances, m/N. Shaft: from the length of the point's share in each region. Tip, across the needle: that of a shaft one radius
   longer than the tip's share (near the surface, tissue supports a tip only if it is pushed in). Tip, along the needle: that of a disc under the cutting force;
   the adjacent shaft acts in parallel. RT */
void find_local_compliance(const tick_input *tick, const insertion_state *state, const contact_points *points, tissue_step *tissue);

/* Sets the bounds on the forces along the needle. RT */
void bound_contacts(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, resistance_ahead *ahead,
                    hole_edge *edges, contact_problem *problem);

/* Assembles the compliance of tissue, needle and mount between all points, in the points' frames, with the local compliances on the diagonal. RT */
void assemble_compliance(const tick_input *tick, const insertion_state *state, insertion_workspace *w);

/* Assembles the gaps that would open if there were no contact forces. RT */
void assemble_gaps(const tick_input *tick, const insertion_state *state, insertion_workspace *w);

#endif
