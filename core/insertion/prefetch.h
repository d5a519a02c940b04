/* The tick's window on the tissue: what the newest snapshot says about it, and what to ask for next. */
#ifndef TROCAR_PREFETCH_H
#define TROCAR_PREFETCH_H

#include "insertion/insertion.h"

static const double WINDOW_SPAN = 5e-3; /* m before and behind the tip, between which the tissue's displacement gradient is taken */

/* Handles of four nominal nodes in the snapshot; false if one is not there. RT */
bool prefetch_covers(const compliance_snapshot *snapshot, const int nodes[4], int handles[4]);

/* Compliance between two handles, m/N. RT */
mat3 compliance_between(const compliance_snapshot *snapshot, int handle, int other);

/* Compliance between the point of these corners and weights, and a handle. RT */
mat3 compliance_to_point(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], int other);

/* Contact nodes at the front of the list whose rows the snapshot holds. RT */
int prefetch_known_contacts(const compliance_snapshot *snapshot, const refinement *refined);

/* Brings state->request up to date: contact nodes, and the nodes of the elements around the tip, behind it and ahead. RT */
void prefetch_request(const insertion_model *model, insertion_state *state);

#endif
