/* Writes and reads saved states, passing only the struct members that are in use. On reading, all other members become zero, except in snapshots. */
#ifndef TROCAR_SAVED_STATE_H
#define TROCAR_SAVED_STATE_H

#include "insertion/seeds.h"
#include "probe/probe.h"
#include "resting/resting_needle.h"
#include "saved/state_stream.h"
#include "snapshot/needle_hold.h"

/* saved_layout returns a number that depends on SAVED_FORMAT and on the sizes of the saved structs, so that a state in another layout is recognised. */
enum { SAVED_FORMAT = 5 };   /* increase this when the meaning or the order of the stored members changes */
uint64_t saved_layout(void);

/* `segments`: how many segments the needle has. */
void saved_insertion(state_stream *s, int segments, insertion_state *state);

/* On reading, the rows of unused handles keep their old values, which are finite but meaningless. */
void saved_snapshot(state_stream *s, compliance_snapshot *snapshot);

void saved_resting(state_stream *s, int segments, resting_needle *needle);
void saved_seeds(state_stream *s, int needle_count, seed_list *seeds);
void saved_probe(state_stream *s, probe_state *probe);
void saved_hold(state_stream *s, needle_hold *hold);

#endif
