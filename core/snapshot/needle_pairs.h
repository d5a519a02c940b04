/* The interaction of needles that are closer to each other than one element, as far as the mesh does not resolve it ("unresolved"). See docs/mechanics.md,
   "Needles close to each other". */
#ifndef TROCAR_NEEDLE_PAIRS_H
#define TROCAR_NEEDLE_PAIRS_H

#include "snapshot/snapshot.h"

typedef struct needle_pairs needle_pairs;

/* Creates the data for the interaction of needles with this radius (m). `t` must outlive them. NO_MEMORY. */
trocar_status needle_pairs_create(const tissue *t, double radius, needle_pairs **created, trocar_error *why);
void needle_pairs_free(needle_pairs *p);

/* To be called after the tissue's moduli have changed. */
void needle_pairs_soften(needle_pairs *p);

/* A needle's track, divided into short steps. */
typedef struct {
    double start, step;      /* m, depth at which the first step starts, and length of a step */
    int count;
    struct {
        int tet;             /* nominal element; -1 outside the tissue */
        double weights[4];
        vec3 place, direction; /* place, m: middle of the step; direction: unit vector along the step */
        line_in_tet line;    /* line of the shaft_piece that contains the step */
    } at[SHIFT_STEPS];
} shaft_steps;

/* Divides the track on which these loads act, extended by `ahead` (m) beyond its end, into steps of at least `finest` (m). Residual loads are not on the
   track. Without loads, there are no steps. */
void shaft_steps_lay(const mesh *m, const tissue_loads *own, double ahead, double finest, shaft_steps *steps);

/* For each step, computes the mean unresolved displacement per unit force on the piece (m/N); loads near the surface cause less of it. It is zero except for
   steps *from to *to - 1; `lacks` has room for SHIFT_STEPS entries. NUMERIC if a patch has no stiffness; NO_MEMORY. */
trocar_status needle_pairs_find(needle_pairs *p, const shaft_steps *steps, const shaft_piece *piece, int *from, int *to, mat3 *lacks, trocar_error *why);

/* Adds the shaft's unresolved displacement under these loads. */
trocar_status needle_pairs_shift(needle_pairs *p, const shaft_steps *steps, const tissue_loads *loads, unresolved_shift *shift, trocar_error *why);

/* Like needle_pairs_shift, for the needle's own residual loads, term by term; smaller in the holes where they were exerted, and near the surface. */
trocar_status needle_pairs_residual_shift(needle_pairs *p, const shaft_steps *steps, const residual_loads *loads, unresolved_shift shift[MAX_RELAXATION],
                                          trocar_error *why);

#endif
