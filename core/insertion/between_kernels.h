/* The arithmetic of between_points.c. Points are numbered by their places from base to tip, and all that is computed is laid out by components,
   so that several points pass at once. */
#ifndef TROCAR_BETWEEN_KERNELS_H
#define TROCAR_BETWEEN_KERNELS_H

#include "base/part.h"
#include "insertion/tick.h"

typedef double between_rows[3][3][BETWEEN_PLACES]; /* [a][b]: component a, b of each place */

/* Of the point in one place with those in places [begin, end), in whole vectors, of which the first may begin earlier, at place `lowest`. */
typedef struct {
    int lowest, begin, end;
    const needle_point *point;
    const double (*needle)[3][BETWEEN_PLACES]; /* m/N, world frame, [row][b]: how joints move, from the point's first on, under unit forces at each place */
    const double *tissue[3][3];    /* m/N, world frame, before it is multiplied by `yield`: that of place l is at l + shift, for places before `tip_place` */
    int shift;
    double yield;
    int tip_place;                 /* or the number of places, without a tip */
    mat3 at_tip;                   /* m/N, world frame: the tissue's compliance with the tip */
    double mount;                  /* m/N */
    const between_rows *frames;    /* [a][b]: component a of axis b */
} between_points_row;

/* Compliance of tissue, needle and mount, in the frames of the points. Each number is the result of the same operations in the same order
   whatever the width of vectors. RT */
typedef void between_kernel(const between_points_row *row, between_rows blocks);

/* For any processor that can run this program, for AVX-512 (x86-64 only), and the best for this processor. RT */
extern between_kernel between_portable, between_avx512;
between_kernel *between_kernel_here(void);

#endif
