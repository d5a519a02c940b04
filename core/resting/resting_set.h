/* The set of resting needles as attachments to the tissue: their forces under other loads, and their slips where friction is exceeded. */
#ifndef TROCAR_RESTING_SET_H
#define TROCAR_RESTING_SET_H

#include "resting/resting_needle.h"
#include "snapshot/snapshot.h"

typedef struct {
    inverse *inverse;        /* attached */
    needle_pairs *pairs;
    int count;
    resting_needle *needles[MAX_NEEDLES];
    int row[MAX_NEEDLES], motion[MAX_NEEDLES]; /* index of each needle's first row and motion */
    double *force, *move;    /* scratch: forces of all rows, and all motions */
    double *aside, *aside_move; /* responses to displacements by held needles that the mesh does not resolve */
    bool any_aside;          /* `aside` is not zero */
    double *load;            /* N: forces at all rows without held needles, loads beside them, and the fading part: other_loads.attached */
    double fading;           /* remaining fraction of the needles' `fading`: from 1 to 0 */
    double *columns[MAX_NEEDLES]; /* responses to a unit slip at each of the needle's points; NULL: not needed yet */
    int columns_known[MAX_NEEDLES]; /* number of columns found so far */
    int load_room, *nodes;   /* scratch for the loads of held needles */
    vec3 *nodal;
    int next_slip, quiet, slips_left; /* next needle to check; number of needles checked since the last slip; largest number of checks left */
    bool slipped;            /* slips that `load` does not contain yet */
    uint64_t changes;        /* number of changes of the set */
    uint64_t shifts;         /* number of changes of `load` */
} resting_set;

void resting_set_free(resting_set *s); /* frees neither the needles nor the inverse */

/* Sets the resting needles, in this order. Their forces stay unchanged under the loads `held`. On a failure nothing is attached, and the set is empty.
   Allocates. */
trocar_status resting_set_change(resting_set *s, int count, resting_needle *const *needles, const other_loads *held, report *why);

/* Sets the resting needles, in this order, and continues from their stored forces: after a restore. */
trocar_status resting_set_attach(resting_set *s, int count, resting_needle *const *needles, report *why);

/* Computes their forces and motions under these loads. */
trocar_status resting_set_load(resting_set *s, const other_loads *held, report *why);

/* Lets needles slip whose forces exceed their friction bounds: one after another, at most `most` per call. Returns true if there are more. */
bool resting_set_slip(resting_set *s, const insertion_model *model, int most);

/* A release: before it, all resting needles record their forces (resting_bore does so for the released needle); after it, the change begins to fade. */
void resting_set_before_release(resting_set *s);
void resting_set_after_release(resting_set *s);

/* Sets the remaining fraction of the change. Returns true if it has changed. */
bool resting_set_fade(resting_set *s, double part);

/* Adds the displacements of a shaft by their forces that the mesh does not resolve. `fades`: with the fading part of the forces, otherwise without it. */
trocar_status resting_set_shift(const resting_set *s, bool fades, const shaft_steps *steps, unresolved_shift *shift, report *why);

/* Loads of one resting needle on the tissue. */
void resting_loads(const resting_needle *r, tissue_loads *loads);

#endif
