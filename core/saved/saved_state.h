/* The members of the mutable structs that are in use, for saved states. What is not in use becomes zero when it is read, except in snapshots. */
#ifndef TROCAR_SAVED_STATE_H
#define TROCAR_SAVED_STATE_H

#include "insertion/seeds.h"
#include "probe/probe.h"
#include "resting/resting_needle.h"
#include "saved/state_stream.h"
#include "snapshot/needle_hold.h"

/* A number that changes whenever one of these structs changes its size or SAVED_FORMAT is increased. */
enum { SAVED_FORMAT = 1 };   /* to be increased when the meaning of a member changes, or the order in which members are passed */
uint64_t saved_layout(void);

/* `segments`: number of the needle's segments. */
void saved_insertion(state_stream *s, int segments, insertion_state *state);

/* The rows of unused handles keep their old values, which are finite and meaningless. */
void saved_snapshot(state_stream *s, compliance_snapshot *snapshot);

void saved_resting(state_stream *s, int segments, resting_needle *needle);
void saved_seeds(state_stream *s, int needle_count, seed_list *seeds);
void saved_probe(state_stream *s, probe_state *probe);
void saved_hold(state_stream *s, needle_hold *hold);

#endif
