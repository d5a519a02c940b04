/* What the tick asks the worker for next. */
#ifndef TROCAR_PREFETCH_H
#define TROCAR_PREFETCH_H

#include "insertion/state/insertion_model.h"
#include "insertion/state/insertion_state.h"

static const double DENT_DEPTH = 20e-3; /* m: by which other needles may have displaced the skin where a needle goes in. Chosen */

/* Brings state->request up to date: contact nodes, and the nodes of the elements around the tip, behind it and ahead. RT */
void prefetch_request(const insertion_model *model, insertion_state *state);

#endif
