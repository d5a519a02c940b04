/* The resting needles, attached to the tissue as a set: their forces under other loads, and their slips where friction is exceeded. */
#ifndef TROCAR_RESTING_SET_H
#define TROCAR_RESTING_SET_H

#include "resting/unresolved_cache.h"
#include "snapshot/snapshot.h"

typedef struct {
    inverse *inverse;        /* the inverse that the needles are attached to */
    needle_pairs *pairs;
    int count;
    resting_needle *needles[MAX_NEEDLES];
    int row[MAX_NEEDLES], motion[MAX_NEEDLES]; /* index of each needle's first row and first motion */
    double *force, *move;    /* scratch: the forces of all rows, and all motions */
    double *aside, *aside_move; /* responses to displacements that held needles cause and the mesh does not resolve */
    bool any_aside;          /* true if `aside` is not zero */
    unresolved_cache caches[MAX_NEEDLES][MAX_NEEDLES]; /* one per pair of a resting and a held needle; the held needle's index is that in other_loads.of */
    uint64_t cached_at;     /* value of `changes` when the caches were filled */
    double *load;            /* N, for all rows: forces when no needle is held, other loads at the same places, and the fading part (see other_loads.attached)
                                */
    double fading;           /* the fraction of the needles' `fading` that remains, from 1 down to 0 */
    double *columns[MAX_NEEDLES]; /* responses to a unit slip at each of the needle's points; NULL until they are needed */
    int columns_known[MAX_NEEDLES]; /* how many columns have been computed */
    int load_room, *nodes;   /* scratch memory for the loads of held needles */
    vec3 *nodal;
    int next_slip, quiet, slips_left; /* next needle to check; needles checked since the last slip; checks left */
    bool slipped;            /* `load` does not include the latest slips yet */
    uint64_t changes;        /* counts changes to the set and to the moduli */
    uint64_t shifts;         /* number of changes to `load` */
} resting_set;

void resting_set_free(resting_set *s); /* does not free the needles or the inverse */

/* Sets the resting needles, in this order, without changing their forces under the loads `held`. After an error, nothing is attached and the set is empty.
   Allocates. */
trocar_status resting_set_change(resting_set *s, int count, resting_needle *const *needles, const other_loads *held, trocar_error *why);

/* Sets the resting needles, in this order, with the forces stored in them. For restoring a saved state. */
trocar_status resting_set_attach(resting_set *s, int count, resting_needle *const *needles, trocar_error *why);

/* Computes the needles' forces and motions under these loads. */
trocar_status resting_set_load(resting_set *s, const other_loads *held, trocar_error *why);

/* Lets needles slip where their forces exceed friction, one needle after another. At most `most` needles slip per call. Returns true if more have to. */
bool resting_set_slip(resting_set *s, const insertion_model *model, int most);

/* Computes the displacements (m) of all rows from the needles' current forces and from the compliance of tissue and needles. Allocates *displacement. */
trocar_status resting_set_displacement(resting_set *s, const other_loads *held, double **displacement, trocar_error *why);

/* Changes the needles' forces and motions so that their rows stay where they were, after the compliance has changed and the needles have been attached again
   (resting_set_change). `before`: the displacements before the change. */
trocar_status resting_set_follow(resting_set *s, const other_loads *held, const double *before, trocar_error *why);

/* Call these before and after a needle is released. The first records the forces of all resting needles (resting_bore does this for the released needle); the
   second starts to fade in the effect of the change. */
void resting_set_before_release(resting_set *s);
void resting_set_after_release(resting_set *s);

/* Sets how much of the fading change remains, 0 to 1. Returns true if this differs from before. */
bool resting_set_fade(resting_set *s, double part);

/* Adds how far the resting needles displace a shaft, counting only what the mesh does not resolve. `fades`: whether to include the fading part of their forces.
   */
trocar_status resting_set_shift(const resting_set *s, bool fades, const shaft_steps *steps, unresolved_shift *shift, trocar_error *why);

/* Lists the loads of one resting needle on the tissue. */
void resting_loads(const resting_needle *r, tissue_loads *loads);

#endif
