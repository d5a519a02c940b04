/* The strata along the track: where it passes from one region into the next, or into a gap between bodies. */
#ifndef TROCAR_STRATA_H
#define TROCAR_STRATA_H

#include "insertion/state/tick_data.h"

/* Records that the track enters `region` (or IN_A_GAP) at the tip. RT */
void note_stratum(insertion_state *state, tick_output *output, int region);

/* Records that the track enters the tip's region. RT */
void enter_stratum(const tick_input *tick, insertion_state *state, tick_output *output);

/* Removes the strata ahead of the tip after it has been drawn back. RT */
void drop_strata_ahead(insertion_state *state);

/* Returns the depth (m) from which the tissue around the track has not slid relative to that at the tip: where the track last entered a body or crossed a
   surface on which the tissue slides. RT */
double tip_bonded_depth(const insertion_state *state);

/* Returns the index of the last stratum that begins less deep than `depth`, at a surface on which the tissue slides; -1 if there is none. RT */
int last_sliding(const insertion_state *state, double depth);

/* Returns the index of the last gap in the list of strata, or -1. RT */
int last_gap(const insertion_state *state);

/* Returns the depth (m) at which the track entered the tip's current body; 0 in the first body. RT */
double tip_entry_depth(const insertion_state *state);

#endif
