/* What the newest snapshot tells the tick: which contacts can be active, where the tip's force acts, and how far the tissue is displaced. */
#ifndef TROCAR_KNOWN_TISSUE_H
#define TROCAR_KNOWN_TISSUE_H

#include "insertion/state/tick_data.h"

/* Returns the displacement (m) of a point under the needle's current forces and those of other bodies, given the handles and weights of the corners of its
   element. RT */
vec3 displacement_at(const tick_input *tick, const insertion_state *state, const creep_step *creep, const int handles[4], const double weights[4]);

/* Returns the displacement (m) at the tip or, after the tip has left the tissue, where it left. Zero if the snapshot does not cover that point. RT */
vec3 displacement_at_tip(const tick_input *tick, const insertion_state *state, const creep_step *creep);

/* Activates the contacts whose rows of the inverse have arrived, and gives them the force on their share of the shaft. Returns how many. RT */
int accept_snapshot(const tick_input *tick, insertion_state *state, tick_output *output);

/* Finds the handles of the corners around the tip or, if the worker is late, around the last point that the snapshot covered. If there is none, sets the first
   to NO_HANDLE, and the mesh is treated as rigid. The tip's force acts on the nominal mesh by interpolation. A separate node at the tip would become stiffer as
   the tip approached a face, and would add less compliance than the mesh already has. RT */
void follow_known_point(const tick_input *tick, insertion_state *state, tick_output *output, int handles[4]);

/* Updates the mesh's resolution at the tip without a jump. If the worker is late, uses the last measurement or an estimate, so that forces always act on a tip
   in the tissue. RT */
void follow_resolution(const tick_input *tick, insertion_state *state, tick_output *output);

#endif
