/* The tick's next request to the worker. */
#ifndef TROCAR_PREFETCH_H
#define TROCAR_PREFETCH_H

#include "insertion/model/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* Updates state->request with the contact nodes and the nodes of the elements around, behind and ahead of the tip. RT */
void prefetch_request(const insertion_model *model, insertion_state *state);

#endif
