/* How needles less than one element apart interact, beyond what the mesh resolves. Displacements that the mesh does not resolve are called unresolved. See
   docs/mechanics.md, "Needles close to each other". */
#ifndef TROCAR_NEEDLE_PAIRS_H
#define TROCAR_NEEDLE_PAIRS_H

#include "snapshot/snapshot.h"

typedef struct needle_pairs needle_pairs;

/* Creates the data for needles of this radius (m). `t` must outlive them. NO_MEMORY. */
trocar_status needle_pairs_create(const tissue *t, double radius, needle_pairs **created, trocar_error *why);
void needle_pairs_free(needle_pairs *p);

/* Call this after the tissue's moduli have changed. */
void needle_pairs_soften(needle_pairs *p);

/* A needle's track, cut into short steps. */
typedef struct {
    double start, step;      /* m, depth at which the first step starts; length of a step */
    int count;
    struct {
        int tet;             /* nominal element; -1 if outside the tissue */
        double weights[4];
        vec3 place, direction; /* place: middle of the step, m; direction: unit vector along the step */
        line_in_tet line;    /* line of the shaft_piece that the step is on */
    } at[SHIFT_STEPS];
} shaft_steps;

/* Cuts the track on which these loads act, plus another `ahead` metres beyond its end, into steps of at least `finest` (m). Ignores residual loads, because
   they are not on the track. If there are no loads, there are no steps. */
void shaft_steps_lay(const mesh *m, const tissue_loads *own, double ahead, double finest, shaft_steps *steps);

/* Computes each step's mean unresolved displacement per unit force on the piece (m/N), which is smaller for loads near the surface. Only steps *from to *to - 1
   can be nonzero. `lacks` has SHIFT_STEPS entries. NUMERIC if a patch has no stiffness; NO_MEMORY. */
trocar_status needle_pairs_find(needle_pairs *p, const shaft_steps *steps, const shaft_piece *piece, int *from, int *to, mat3 *lacks, trocar_error *why);

/* Adds the unresolved displacement of the shaft under these loads. */
trocar_status needle_pairs_shift(needle_pairs *p, const shaft_steps *steps, const tissue_loads *loads, unresolved_shift *shift, trocar_error *why);

/* Like needle_pairs_shift, for each term of the needle's own residual loads. The displacement is reduced in the holes where the loads were exerted, and near
   the surface. */
trocar_status needle_pairs_residual_shift(needle_pairs *p, const shaft_steps *steps, const residual_loads *loads, unresolved_shift shift[MAX_RELAXATION],
                                          trocar_error *why);

#endif
