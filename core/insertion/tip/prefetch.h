/* The tick's next request to the worker. */
#ifndef TROCAR_PREFETCH_H
#define TROCAR_PREFETCH_H

#include "insertion/model/insertion_model.h"
#include "insertion/state/insertion_state.h"

static const double DENT_DEPTH = 20e-3; /* m: largest displacement of the skin, caused by other needles, at a needle's entry. Chosen by judgement */

/* Updates state->request: the contact nodes, and the nodes of the elements around, behind and ahead of the tip. RT */
void prefetch_request(const insertion_model *model, insertion_state *state);

#endif
