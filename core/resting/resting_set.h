/* The set of resting needles as attachments to the tissue: their forces under other loads, and their slips where the friction limit is exceeded. */
#ifndef TROCAR_RESTING_SET_H
#define TROCAR_RESTING_SET_H

#include "resting/unresolved_cache.h"
#include "snapshot/snapshot.h"

typedef struct {
    inverse *inverse;        /* the inverse to which the needles are attached */
    needle_pairs *pairs;
    int count;
    resting_needle *needles[MAX_NEEDLES];
    int row[MAX_NEEDLES], motion[MAX_NEEDLES]; /* index of each needle's first row and motion */
    double *force, *move;    /* scratch: forces of all rows, and all motions */
    double *aside, *aside_move; /* responses to displacements by held needles that the mesh does not resolve */
    bool any_aside;          /* true if `aside` is not zero */
    unresolved_cache caches[MAX_NEEDLES][MAX_NEEDLES]; /* one for each pair of a resting needle and a held one, at its index in other_loads.of */
    uint64_t cached_at;     /* value of `changes` for which the caches are valid */
    double *load;            /* N, for all rows: forces in the absence of held needles, other loads at the same places, and the fading part (see
                                other_loads.attached) */
    double fading;           /* remaining fraction, from 1 to 0, of the needles' `fading` */
    double *columns[MAX_NEEDLES]; /* responses to a unit slip at each of the needle's points; NULL until needed */
    int columns_known[MAX_NEEDLES]; /* number of columns computed so far */
    int load_room, *nodes;   /* scratch memory for the loads of held needles */
    vec3 *nodal;
    int next_slip, quiet, slips_left; /* next needle to check; number of needles checked since the last slip; maximum number of remaining checks */
    bool slipped;            /* true if `load` does not contain the latest slips yet */
    uint64_t changes;        /* number of changes to the set or the moduli */
    uint64_t shifts;         /* number of changes to `load` */
} resting_set;

void resting_set_free(resting_set *s); /* frees neither the needles nor the inverse */

/* Sets the resting needles, in this order. Their forces under the loads `held` do not change. After a failure, nothing is attached and the set is empty.
   Allocates. */
trocar_status resting_set_change(resting_set *s, int count, resting_needle *const *needles, const other_loads *held, trocar_error *why);

/* Sets the resting needles, in this order, with their stored forces, after a restore. */
trocar_status resting_set_attach(resting_set *s, int count, resting_needle *const *needles, trocar_error *why);

/* Computes the needles' forces and motions under these loads. */
trocar_status resting_set_load(resting_set *s, const other_loads *held, trocar_error *why);

/* Lets needles slip whose forces exceed their friction bounds, one after another, up to `most` per call. Returns true if more needles have to slip. */
bool resting_set_slip(resting_set *s, const insertion_model *model, int most);

/* Computes the displacements (m) of all rows from the current forces of all needles and the compliances of tissue and needles. Allocates *displacement. */
trocar_status resting_set_displacement(resting_set *s, const other_loads *held, double **displacement, trocar_error *why);

/* To be called after the compliances have changed and the needles have been attached again (resting_set_change). Changes the needles' forces and motions so
   that their rows have the same displacements as before. `before`: displacements before the change. */
trocar_status resting_set_follow(resting_set *s, const other_loads *held, const double *before, trocar_error *why);

/* To be called before and after a needle is released. The first records the forces of all resting needles (resting_bore records those of the released one); the
   second starts to fade in the effect of the change. */
void resting_set_before_release(resting_set *s);
void resting_set_after_release(resting_set *s);

/* Sets the remaining fraction of the fading change. Returns true if it has changed. */
bool resting_set_fade(resting_set *s, double part);

/* Adds a shaft's displacements under the resting needles' forces, as far as the mesh does not resolve them. `fades`: true to include the fading part of the
   forces. */
trocar_status resting_set_shift(const resting_set *s, bool fades, const shaft_steps *steps, unresolved_shift *shift, trocar_error *why);

/* Writes the loads of one resting needle on the tissue. */
void resting_loads(const resting_needle *r, tissue_loads *loads);

#endif
