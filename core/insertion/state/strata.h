/* The layers along the track: where it goes from one region into the next, or into a gap between bodies. */
#ifndef TROCAR_STRATA_H
#define TROCAR_STRATA_H

#include "insertion/state/tick.h"

/* Records that the track enters `region` (or IN_A_GAP) at the tip. RT */
void note_stratum(insertion_state *state, tick_output *output, int region);

/* The same with the region that the tip is in. RT */
void enter_stratum(const tick_input *tick, insertion_state *state, tick_output *output);

/* Forgets the layers ahead of a tip that was drawn back. RT */
void drop_strata_ahead(insertion_state *state);

/* The last gap among the strata, or -1. RT */
int last_gap(const insertion_state *state);

/* Depth at which the track entered the body that the tip is in, m: 0 in the first one. RT */
double tip_entry_depth(const insertion_state *state);

#endif
