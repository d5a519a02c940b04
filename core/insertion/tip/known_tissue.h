/* What the newest snapshot tells the tick: which contacts can take part, where the tip's force acts, how the tissue is displaced. */
#ifndef TROCAR_KNOWN_TISSUE_H
#define TROCAR_KNOWN_TISSUE_H

#include "insertion/state/tick.h"

/* Displacement of a point under the present forces, and others' on the tissue, m: handles and weights of the corners of its element. RT */
vec3 displacement_at(const tick_input *tick, const insertion_state *state, const creep_step *creep, const int handles[4], const double weights[4]);

/* The same at the tip, or, after it has left the tissue, where it left. Zero if the snapshot does not cover that point. RT */
vec3 displacement_at_tip(const tick_input *tick, const insertion_state *state, const creep_step *creep);

/* Contacts whose rows of the inverse have arrived start to take part, with the force on the shaft that they stand for. Returns how many. RT */
int accept_snapshot(const tick_input *tick, insertion_state *state, tick_output *output);

/* Handles of the corners around the tip; if the worker is late, around the last point that the snapshot covered, or NO_HANDLE: there is none, and
   the mesh counts as rigid. The tip's force acts on the nominal mesh by interpolation: a node of its own would become stiffer as it came nearer to a
   face, and what it would add is below what the mesh resolves. RT */
void follow_known_point(const tick_input *tick, insertion_state *state, tick_output *output, int handles[4]);

/* Brings up to date what the mesh resolves at the tip, without a jump. If the worker is late, as at the last place where it was measured, or an estimate: a
   tip in the tissue is never without force. RT */
void follow_resolution(const tick_input *tick, insertion_state *state, tick_output *output);

#endif
