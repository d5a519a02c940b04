/* The effect of a needle's state on other needles and viewers: its refined mesh, and its loads on the tissue. */
#ifndef TROCAR_INSERTION_LOADS_H
#define TROCAR_INSERTION_LOADS_H

#include "insertion/state/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* The present refined mesh: the active contact nodes, from base to tip, in consecutive slots. */
void insertion_refinement(const insertion_state *state, refinement *out);

/* Adds the forces on the tissue to `nominal` (node_count), and writes those on the active contact nodes to `added`, in the order of insertion_refinement; N,
   world frame. The tip's force is distributed to the corners of its element. In creeping tissue, these are the forces that would displace elastic tissue
   equally. */
void insertion_forces(const insertion_model *model, const insertion_state *state, vec3 *nominal, vec3 *added);

/* Sets the positions of the needle's loads on the tissue: its active contacts, then the tip, if that is in the tissue. The forces are 0. RT */
void insertion_place_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

/* Adds the same forces as loads on the nominal mesh, for the other needles in the tissue, together with the residual loads. RT */
void insertion_add_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

/* Adds only the residual loads: forces that relaxing tissue remembers at places that the needle has left. RT */
void insertion_add_residual_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

#endif
