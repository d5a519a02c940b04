/* What a needle's state means for others: its refined mesh, and its loads on the tissue. */
#ifndef TROCAR_INSERTION_LOADS_H
#define TROCAR_INSERTION_LOADS_H

#include "insertion/state/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* The refined mesh as the needle sees it now: the active contact nodes, from base to tip, in slots without gaps. */
void insertion_refinement(const insertion_state *state, refinement *out);

/* Adds the forces on the tissue to `nominal` (node_count) and writes those on the active contact nodes to `added`, in the same order; N, world
   frame. The tip's is spread over its element's corners. Where the tissue creeps, these are the forces that would displace it as far if
   it were elastic. */
void insertion_forces(const insertion_model *model, const insertion_state *state, vec3 *nominal, vec3 *added);

/* Where the needle loads the tissue: at its active contacts, then at the tip, if that is in the tissue. The forces are 0. RT */
void insertion_place_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

/* The same forces as loads on the nominal mesh there, for the other needles in the tissue, and what it has left elsewhere. RT */
void insertion_add_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

/* Those of them that relaxing tissue remembers where the needle is no longer. RT */
void insertion_add_residual_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads);

#endif
