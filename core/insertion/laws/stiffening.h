/* Stiffening tissue in the contact problem: the non-linear part of the local compliances. If no region stiffens, these functions do nothing. See
   docs/mechanics.md, "Stiffening". */
#ifndef TROCAR_STIFFENING_H
#define TROCAR_STIFFENING_H

#include "insertion/state/tick_data.h"

/* Averages over a share of the shaft: material factor of the local compliance to an axial line force (m^2/N; see local_line_stiffness), and stiffening
   coefficient. */
typedef struct {
    double softness, stiffening;
} stiffened_shaft;

/* Returns by how much (m) the shaft's displacement relative to the tissue changes, beyond the linear part, when a share under this traction (N/m) extends into
   another region. RT */
double stiffening_lead(const insertion_model *model, stiffened_shaft before, stiffened_shaft now, double traction);

/* Sets up the laws for this step's points. Call this after find_local_compliance and before creep_prepare. RT */
void stiffening_prepare(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, stiffening_step *stiffening);

/* Returns by how much (m/N) stiffening changes the compliance along the shaft at point i under this force; at most 0. RT */
double stiffening_slope(const stiffening_step *stiffening, int i, double force);

/* Linearises the laws: in the first pass about the current forces, later about those of the last pass. RT */
void stiffening_linearise(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                          stiffening_step *stiffening, const damper_step *damper, bool first);

/* Add the linearised laws to the compliance and the gaps of the contact problem. RT */
void stiffening_add_compliance(const insertion_state *state, const contact_points *points, const tissue_step *tissue, const stiffening_step *stiffening,
                               contact_problem *problem);
void stiffening_shift_gaps(const insertion_state *state, const contact_points *points, const tissue_step *tissue, const stiffening_step *stiffening,
                           contact_problem *problem);

/* True if the laws at the new forces agree with their linearisation. RT */
bool stiffening_agrees(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                       const stiffening_step *stiffening, const damper_step *damper);

#endif
