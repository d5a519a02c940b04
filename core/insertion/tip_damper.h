/* The damper at the tip: where it cuts, tissue springs back no faster than a shear wave crosses its dent. See README.md, "After
   a puncture". */
#ifndef TROCAR_TIP_DAMPER_H
#define TROCAR_TIP_DAMPER_H

#include "insertion/tick.h"

/* Part of the way to its static place that the tissue at the tip goes in this step. While the tip sticks, the tissue follows the
   hand, which is far slower than waves: all of the way. RT */
double tip_relaxed(const insertion_model *model, const needle_tip *tip, double dt);

/* A new node changes what the mesh makes of the same forces by a few per cent. That alone must not move the tip: it is taken off, and fades as the tip moves
   on. After stiffening_linearise. RT */
void keep_dent(const tick_context *tick);

/* Eliminates the damper's force from the contact problem. In a step the dent goes the part 1 - exp(-c dt / dent) of the way to the
   displacement u that the forces would hold statically, c being the wave speed: dent' = relaxed u + (1 - relaxed) dent. The
   damper's force on the tissue is (dent' - u) over the tip's compliance. It takes a matrix of rank 1 off the tissue's
   compliance, which stays positive semidefinite. RT */
void damp_tip(const tick_context *tick);

/* The damper's force with the forces of the last pass. RT */
void take_damping(const tick_context *tick);

/* The dent after this step, and the damper's force. RT */
void spring_back(const tick_context *tick);

#endif
