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
    const double (*needle)[3][BETWEEN_PLACES]; /* m/N, [row][b]: displacement of the needle's joints, from the point's first on, under unit forces at each place; world frame */
    const double *tissue[3][3];    /* of each place, times `yield` m/N, world frame; */
    int known;                     /* of places before this one. At this one it is */
    mat3 beyond;                   /* m/N */
    double yield;
    double mount;                  /* m/N */
    const between_rows *frames;    /* [a][b]: component a of axis b */
} between_points_row;

/* Compliance of tissue, needle and mount, in the frames of the points. Each number is the result of the same operations in the same order
   whatever the width of vectors. RT */
typedef void between_kernel(const between_points_row *row, between_rows blocks);

/* That which any processor has that can run this program, that of AVX-512 (x86-64 only), and the widest that this processor has. RT */
extern between_kernel between_portable, between_avx512;
between_kernel *between_kernel_here(void);

#endif
