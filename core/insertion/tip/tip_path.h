/* The tip's path through the nominal mesh: forward from element to element, along outer faces, and back along the track. */
#ifndef TROCAR_TIP_PATH_H
#define TROCAR_TIP_PATH_H

#include "insertion/state/tick.h"

enum { MAX_STEPS = 256 }; /* elements: crossed in one step, at most. Effort */
static const double FACE_CLEARANCE = 1e-7; /* m: the tip is put this far past a face that it crosses. Rounding */

/* Cuts forward by `distance` along the unit nominal direction: leaves contacts where they are due. Membranes stop the tip, if they resist
   more than what it cuts. RT */
void cut_forward(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction, double distance);

/* Draws back by `distance` along the track, taking up contact nodes on the way. RT */
void draw_back(const tick_input *tick, insertion_state *state, tick_output *output, double distance);

/* What is in front of the tip, a membrane or bone, gives way: the tip is behind it. RT */
void puncture_barrier(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction);

/* The needle is out of the tissue. RT */
void withdraw_tip(insertion_state *state, tick_output *output);

/* Follows the line from a nominal point in element `tet` to `target`, element by element, as far as there is tissue, and moves the point to
   `target`. Returns the element reached. RT */
int follow_line(const mesh *m, int tet, vec3 *from, vec3 target);

/* Does the straight line from a hit on the outer surface to x lead through tissue? *tet: the element of x. RT */
bool reaches(const mesh *m, surface_hit hit, vec3 x, int *tet);

#endif
