/* What other needles and viewers need to know about a needle: its refined mesh, and its loads on the tissue. */
#ifndef TROCAR_INSERTION_LOADS_H
#define TROCAR_INSERTION_LOADS_H

#include "insertion/model/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* Writes the current refined mesh, with the active contact nodes in consecutive slots from base to tip. */
void insertion_refinement(const insertion_state *state, refinement *out);

/* Adds the needle's forces on the nominal nodes to `nominal` (node_count), and writes those on the active contact nodes to `added`, in the order of
   insertion_refinement (N, world frame). The tip's force is distributed over the corners of its element. If the tissue creeps, the forces are those that would
   displace elastic tissue by the same amount. */
void insertion_forces(const insertion_model *model, const insertion_state *state, vec3 *nominal, vec3 *added);

/* Lists where the needle loads the tissue: at the active contacts and, if it is in the tissue, at the tip. Sets the forces to 0. RT */
void insertion_place_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

/* Writes the needle's forces as loads on the nominal mesh, for the other needles in the tissue. Includes the residual loads. RT */
void insertion_add_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

/* Appends only the residual loads: forces that relaxing tissue still remembers where the needle no longer is. RT */
void insertion_add_residual_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

#endif
