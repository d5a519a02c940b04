/* All needles that rest, as attachments to the tissue: their forces under what else loads it, and where friction gives way. */
#ifndef TROCAR_RESTING_SET_H
#define TROCAR_RESTING_SET_H

#include "resting/resting_needle.h"
#include "snapshot/snapshot.h"

typedef struct {
    inverse *inverse;        /* attached */
    needle_pairs *pairs;
    int count;
    resting_needle *needles[MAX_NEEDLES];
    int row[MAX_NEEDLES], motion[MAX_NEEDLES]; /* of each needle's first ones */
    double *force, *move;    /* of all rows and motions: scratch; */
    double *aside, *aside_move; /* how they respond to what held needles displace them by and the mesh does not resolve; */
    bool any_aside;          /* which is not zero */
    double *load;            /* N: forces at all rows if no needle were held, what is beside them, and what fades: other_loads.attached */
    double fading;           /* part of the needles' `fading` that is left: from 1 to 0 */
    double *columns[MAX_NEEDLES]; /* responses to a slip at each of the needle's points; NULL: not needed yet; */
    int columns_known[MAX_NEEDLES]; /* found so far */
    int load_room, *nodes;   /* of held needles' loads: scratch */
    vec3 *nodal;
    int next_slip, quiet, slips_left; /* needle that is looked at next; how many have not slipped since; how often to look at most */
    bool slipped;            /* which `load` does not show yet */
    uint64_t changes;        /* of what it holds, */
    uint64_t shifts;         /* and of `load` */
} resting_set;

void resting_set_free(resting_set *s); /* not the needles, nor the inverse */

/* These rest now, in this order. Their forces stay as they are, under these loads by held needles. On a failure nothing is attached, and the set
   is empty. Allocates. */
trocar_status resting_set_change(resting_set *s, int count, resting_needle *const *needles, const other_loads *held, report *why);

/* The same, but continues from the forces that the needles hold: after a restore. */
trocar_status resting_set_attach(resting_set *s, int count, resting_needle *const *needles, report *why);

/* Their forces and motions under these loads. */
trocar_status resting_set_load(resting_set *s, const other_loads *held, report *why);

/* Lets them slip where a force is above what friction can bear: one after another, at most so many in one call. True: there are more. */
bool resting_set_slip(resting_set *s, const insertion_model *model, int most);

/* A release: before it, all that rest note what they bear (resting_bore does it for the one that is let go of); after it, what has
   changed begins to fade. */
void resting_set_before_release(resting_set *s);
void resting_set_after_release(resting_set *s);

/* This part of it is left. True: that is news. */
bool resting_set_fade(resting_set *s, double part);

/* Adds how far their forces displace a shaft beyond what the mesh resolves: with what fades of them, or as it will be then. */
trocar_status resting_set_shift(const resting_set *s, bool fades, const shaft_steps *steps, unresolved_shift *shift, report *why);

/* Loads on the tissue by one of them. */
void resting_loads(const resting_needle *r, tissue_loads *loads);

#endif
