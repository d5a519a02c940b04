/* The damper at the tip: where it cuts, tissue springs back no faster than a shear wave crosses its dent. See
   docs/mechanics.md, "The tip". */
#ifndef TROCAR_TIP_DAMPER_H
#define TROCAR_TIP_DAMPER_H

#include "insertion/state/tick.h"

/* Part of the way to its static place that the tissue at the tip goes in this step. While the tip sticks, the tissue follows the
   hand, which is far slower than waves: all of the way. RT */
double damper_relaxed(const insertion_model *model, const needle_tip *tip, double dt);

/* The force that new contacts take over from the tip displaces it less from where they are. So that it does not spring back by that at once, the difference is kept, and
   fades as fast as shear waves cross the dent. Before the passes. RT */
void damper_keep_dent(insertion_state *state, const contact_points *points, const tissue_step *tissue);

/* Eliminates the damper's force from the contact problem. In a step the dent goes the part 1 - exp(-c dt / dent) of the way to the
   displacement u that the forces would hold statically, c being the wave speed: dent' = relaxed u + (1 - relaxed) dent. The
   damper's force on the tissue is (dent' - u) over the tip's compliance. It takes a matrix of rank 1 off the tissue's
   compliance, which stays positive semidefinite. RT */
void damper_eliminate(const tick_input *tick, const insertion_state *state, insertion_workspace *w);

/* The damper's force with the forces of the last pass. RT */
void damper_find_force(const tick_input *tick, insertion_state *state, const insertion_workspace *w);

/* The dent after this step, and the damper's force. RT */
void damper_conclude(const tick_input *tick, insertion_state *state, const insertion_workspace *w);

#endif
