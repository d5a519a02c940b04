/* Stiffening tissue in the contact problem: the non-linear part of its local compliances. Nothing changes where no tissue stiffens. See
   docs/mechanics.md, "Stiffening". */
#ifndef TROCAR_STIFFENING_H
#define TROCAR_STIFFENING_H

#include "insertion/state/tick.h"

/* A share of the shaft: compliance of a line force per logarithm, m^2/N, and mean stiffening. */
typedef struct {
    double softness, stiffening;
} stiffened_shaft;

/* How much farther ahead of the tissue the shaft is under this traction (N/m) because its share has come to lie in other regions, beyond
   what linear tissue makes of it, m. RT */
double stiffening_lead(const insertion_model *model, stiffened_shaft before, stiffened_shaft now, double traction);

/* The laws of this step's points. After find_local_compliance, before creep_prepare. RT */
void stiffening_prepare(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, stiffening_step *stiffening);

/* Compliance along the shaft at point i under this force, on top of the linear one, m/N; at most 0. RT */
double stiffening_slope(const stiffening_step *stiffening, int i, double force);

/* Linearises: in the first pass about the present forces, then about what the last pass found. RT */
void stiffening_linearise(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                          stiffening_step *stiffening, const damper_step *damper, bool first);

/* Adds what was linearised to the contact problem: to its compliance, and to its gaps. RT */
void stiffening_add_compliance(const insertion_state *state, const contact_points *points, const tissue_step *tissue, const stiffening_step *stiffening,
                               contact_problem *problem);
void stiffening_shift_gaps(const insertion_state *state, const contact_points *points, const tissue_step *tissue, const stiffening_step *stiffening,
                           contact_problem *problem);

/* Do the displacements under the new forces agree with the linearised ones? RT */
bool stiffening_agrees(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                       const stiffening_step *stiffening, const damper_step *damper);

#endif
