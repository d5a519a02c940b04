/* Writes and reads the members of the mutable structs that are in use, for saved states. When a state is read, members that are not in use become zero, except
   in snapshots. */
#ifndef TROCAR_SAVED_STATE_H
#define TROCAR_SAVED_STATE_H

#include "insertion/seeds.h"
#include "probe/probe.h"
#include "resting/resting_needle.h"
#include "saved/state_stream.h"
#include "snapshot/needle_hold.h"

/* saved_layout returns a number that changes whenever the size of one of the saved structs changes or SAVED_FORMAT is increased. */
enum { SAVED_FORMAT = 4 };   /* to be increased when the meaning of a member changes, or the order in which members are stored */
uint64_t saved_layout(void);

/* `segments`: number of the needle's segments. */
void saved_insertion(state_stream *s, int segments, insertion_state *state);

/* When a state is read, the rows of unused handles keep their previous values, which are finite but meaningless. */
void saved_snapshot(state_stream *s, compliance_snapshot *snapshot);

void saved_resting(state_stream *s, int segments, resting_needle *needle);
void saved_seeds(state_stream *s, int needle_count, seed_list *seeds);
void saved_probe(state_stream *s, probe_state *probe);
void saved_hold(state_stream *s, needle_hold *hold);

#endif
