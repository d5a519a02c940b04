/* Data of the newest snapshot for the tick: which contacts can be active, where the tip's force acts, how the tissue is displaced. */
#ifndef TROCAR_KNOWN_TISSUE_H
#define TROCAR_KNOWN_TISSUE_H

#include "insertion/state/tick.h"

/* Displacement of a point under the present forces and those of other bodies, m, from handles and weights of the corners of its element. RT */
vec3 displacement_at(const tick_input *tick, const insertion_state *state, const creep_step *creep, const int handles[4], const double weights[4]);

/* Displacement at the tip or, after the tip has left the tissue, at its exit point, m. Zero if the snapshot does not cover that point. RT */
vec3 displacement_at_tip(const tick_input *tick, const insertion_state *state, const creep_step *creep);

/* Activates contacts whose rows of the inverse have arrived, with the force on their shares of the shaft. Returns their number. RT */
int accept_snapshot(const tick_input *tick, insertion_state *state, tick_output *output);

/* Finds the handles of the corners around the tip or, if the worker is late, around the last point that the snapshot covered; NO_HANDLE if there is none, and
   the mesh counts as rigid. The tip's force acts on the nominal mesh by interpolation: a node of its own would become stiffer as it approached a face, and
   would add less than the mesh resolves. RT */
void follow_known_point(const tick_input *tick, insertion_state *state, tick_output *output, int handles[4]);

/* Updates the mesh's resolution at the tip, without a jump. If the worker is late, the last measurement or an estimate is used, so that a tip in the tissue is
   never without force. RT */
void follow_resolution(const tick_input *tick, insertion_state *state, tick_output *output);

#endif
