/* The effect of a needle's state as seen by other needles and viewers: its refined mesh, and its loads on the tissue. */
#ifndef TROCAR_INSERTION_LOADS_H
#define TROCAR_INSERTION_LOADS_H

#include "insertion/model/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* Writes the current refined mesh: the active contact nodes, from base to tip, in consecutive slots. */
void insertion_refinement(const insertion_state *state, refinement *out);

/* Adds the needle's forces on the tissue to `nominal` (node_count), and writes those on the active contact nodes to `added`, in the order of
   insertion_refinement (N, world frame). The tip's force is distributed to the corners of its element. In creeping tissue, these are the forces that would
   displace elastic tissue by the same amount. */
void insertion_forces(const insertion_model *model, const insertion_state *state, vec3 *nominal, vec3 *added);

/* Sets the positions of the needle's loads on the tissue: the active contacts and, if it is in the tissue, the tip. The forces are set to 0. RT */
void insertion_place_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

/* Adds the needle's forces as loads on the nominal mesh, for the other needles in the tissue; includes the residual loads. RT */
void insertion_add_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

/* Adds only the residual loads: forces that relaxing tissue remembers where the needle no longer is. RT */
void insertion_add_residual_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

#endif
