/* The tip's path through the nominal mesh: forward from element to element, along outer faces, and back along the track. */
#ifndef TROCAR_TIP_WALK_H
#define TROCAR_TIP_WALK_H

#include "insertion/state/tick_data.h"

enum { MAX_STEPS = 256 }; /* elements: most crossed in one step. Cost limit */
static const double FACE_CLEARANCE = 1e-7; /* m: when the tip crosses a face, it is placed this far past it. Rounding tolerance */

/* Cuts forward by `distance` along this unit direction in the undeformed tissue, and leaves contact nodes where they are due. A membrane whose resistance
   exceeds the cutting force stops the tip. `creep`: NULL if the tissue is at rest. RT */
void cut_forward(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, vec3 direction, double distance);

/* Draws the tip back along the track by `distance`, and removes the contact nodes it passes. RT */
void draw_back(const tick_input *tick, insertion_state *state, tick_output *output, double distance);

/* Punctures the membrane or bone in front of the tip, which is behind it afterwards. RT */
void puncture_barrier(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, vec3 direction);

/* Resets the tip once the needle has left the tissue. RT */
void withdraw_tip(insertion_state *state, tick_output *output);

/* Follows the line from a nominal point in element `tet` to `target`, from element to element as long as it is in tissue that does not slide. Moves the point
   to `target` and returns the last element. RT */
int follow_line(const mesh *m, int tet, vec3 *from, vec3 target);

/* True if the straight line from a hit on the outer surface to x stays in the tissue. *tet: the element that contains x. RT */
bool reaches(const mesh *m, surface_hit hit, vec3 x, int *tet);

#endif
