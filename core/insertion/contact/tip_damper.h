/* The damper at the tip: while the tip cuts, the tissue rebounds no faster than a shear wave crosses the dent. See docs/mechanics.md, "The tip". */
#ifndef TROCAR_TIP_DAMPER_H
#define TROCAR_TIP_DAMPER_H

#include "insertion/state/tick_data.h"

/* Returns the fraction of its distance to static equilibrium that the tissue at the tip covers in this step. It is 1 while the tip sticks, because the tissue
   then follows the hand, which is far slower than the waves. RT */
double damper_relaxed(const insertion_model *model, const needle_tip *tip, double dt);

/* When new contacts take over force from the tip, the force acts farther from the tip and displaces it less. To avoid a sudden rebound, this keeps the
   difference as an offset, which fades as fast as shear waves cross the dent. Call this before the passes. RT */
void damper_keep_dent(insertion_state *state, const contact_points *points, const tissue_step *tissue);

/* Eliminates the damper's force from the contact problem. In one step, the dent covers the fraction relaxed = 1 - exp(-c dt / dent) of its distance to the
   static displacement u, where c is the wave speed: dent' = relaxed u + (1 - relaxed) dent. The damper's force on the tissue is (dent' - u) divided by the
   tip's compliance. Eliminating it subtracts a rank-1 matrix from the tissue's compliance, which stays positive semidefinite. RT */
void damper_eliminate(const tick_input *tick, const insertion_state *state, insertion_workspace *w);

/* Computes the damper's force from the forces of the last pass. RT */
void damper_find_force(const tick_input *tick, insertion_state *state, const insertion_workspace *w);

/* Computes the dent at the end of this step, and the damper's force. RT */
void damper_conclude(const tick_input *tick, insertion_state *state, const insertion_workspace *w);

#endif
