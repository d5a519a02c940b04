/* What the mesh does not resolve between needles that are closer to each other than an element. See docs/mechanics.md, "Needles close to each other". */
#ifndef TROCAR_NEEDLE_PAIRS_H
#define TROCAR_NEEDLE_PAIRS_H

#include "snapshot/snapshot.h"

typedef struct needle_pairs needle_pairs;

/* For needles of this radius (m). `t` must outlive it. NO_MEMORY. */
trocar_status needle_pairs_create(const tissue *t, double radius, needle_pairs **created, report *why);
void needle_pairs_free(needle_pairs *p);

/* A needle's track in short steps. */
typedef struct {
    double start, step;      /* m of depth */
    int count;
    struct {
        int tet;             /* nominal, or -1: outside */
        double weights[4];
        vec3 place, direction; /* of its middle */
        line_in_tet line;    /* as of the shaft_piece that it is on */
    } at[SHIFT_STEPS];
} shaft_steps;

/* Divides the track on which these loads act, extended by `ahead` (m) beyond its end, into steps of at least `finest` (m). Without loads
   there are no steps. */
void shaft_steps_lay(const mesh *m, const tissue_loads *own, double ahead, double finest, shaft_steps *steps);

/* Mean displacement of each step, m/N, that the mesh lacks under a force on the piece. It is zero but for steps *from to *to - 1; `lacks` has
   SHIFT_STEPS places. NUMERIC if a patch has no stiffness, NO_MEMORY. */
trocar_status needle_pairs_find(needle_pairs *p, const shaft_steps *steps, const shaft_piece *piece, int *from, int *to, mat3 *lacks, report *why);

/* Adds what these loads do to the shaft. */
trocar_status needle_pairs_shift(needle_pairs *p, const shaft_steps *steps, const tissue_loads *loads, unresolved_shift *shift, report *why);

#endif
