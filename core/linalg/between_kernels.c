/* The kernel declared in between_kernels.h, compiled for one vector width. */
#include "linalg/between_kernels.h"
#include "linalg/simd_wide.h"

#ifndef BETWEEN_KERNEL
#define BETWEEN_KERNEL between_portable
#endif

_Static_assert((int)SIMD_WIDE_WIDTH <= (int)ROW_ROOM, "rows have room for the rest of a vector");

/* Computes the blocks for the places l, l + 1, ... of one vector. `tip`: whether the vector includes the tip or is beyond it. */
static inline __attribute__((always_inline)) void find_vector(const between_points_row *row, int l, bool tip, between_rows blocks) {
    const double (*frame)[3] = row->frame->m, *weights = row->weights;
    simd_wide place = simd_wide_from(l), turned[3][3]; /* turned: rows in the world frame, columns in the frames of the points */
    for (int a = 0; a < 3; a++) {
        simd_wide world[3];
        for (int b = 0; b < 3; b++) {
            simd_wide tissue = simd_wide_load(row->tissue[a][b] + (l + row->shift)), mount = simd_wide_all(a == b ? row->mount : 0.0);
            if (tip) world[b] = row->yield * simd_wide_where(place < row->tip_place, tissue) + (simd_wide_where(place == row->tip_place, simd_wide_all(row->at_tip.m[a][b])) + mount);
            else world[b] = row->yield * tissue + mount;
            for (int m = 0; m < BETWEEN_JOINTS; m++) world[b] += weights[m] * simd_wide_load(&row->needle[3 * m + a][b][l]);
        }
        for (int b = 0; b < 3; b++)
            turned[a][b] = world[0] * simd_wide_load(&(*row->frames)[0][b][l]) + world[1] * simd_wide_load(&(*row->frames)[1][b][l]) + world[2] * simd_wide_load(&(*row->frames)[2][b][l]);
    }
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) simd_wide_store(&blocks[a][b][l], frame[0][a] * turned[0][b] + frame[1][a] * turned[1][b] + frame[2][a] * turned[2][b]);
}

void BETWEEN_KERNEL(const between_points_row *row, between_rows blocks) {
    int whole = simd_wide_below(row->begin), l = whole > row->lowest ? whole : row->lowest;
    for (; l + SIMD_WIDE_WIDTH <= row->tip_place; l += SIMD_WIDE_WIDTH) find_vector(row, l, false, blocks);
    for (; l < row->end; l += SIMD_WIDE_WIDTH) find_vector(row, l, true, blocks);
}
