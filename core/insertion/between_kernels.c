/* The kernel of between_kernels.h for one width of vectors. */
#include "insertion/between_kernels.h"

#ifndef BETWEEN_KERNEL
#define BETWEEN_KERNEL between_portable
#endif

/* One vector of blocks, from place l on; `tip`: with the tip, or beyond it. */
static inline __attribute__((always_inline)) void find_part(const between_points_row *row, int l, bool tip, between_rows blocks) {
    const double (*frame)[3] = row->point->frame.m, *weights = row->point->weights;
    part place = part_from(l), turned[3][3]; /* rows in the world frame, columns in those of the points */
    for (int a = 0; a < 3; a++) {
        part world[3];
        for (int b = 0; b < 3; b++) {
            part tissue = part_load(row->tissue[a][b] + (l + row->shift)), mount = part_all(a == b ? row->mount : 0.0);
            if (tip) world[b] = row->yield * part_where(place < row->tip_place, tissue) + (part_where(place == row->tip_place, part_all(row->at_tip.m[a][b])) + mount);
            else world[b] = row->yield * tissue + mount;
            for (int m = 0; m < NEEDLE_POINT_JOINTS; m++) world[b] += weights[m] * part_load(&row->needle[3 * m + a][b][l]);
        }
        for (int b = 0; b < 3; b++)
            turned[a][b] = world[0] * part_load(&(*row->frames)[0][b][l]) + world[1] * part_load(&(*row->frames)[1][b][l]) + world[2] * part_load(&(*row->frames)[2][b][l]);
    }
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) part_store(&blocks[a][b][l], frame[0][a] * turned[0][b] + frame[1][a] * turned[1][b] + frame[2][a] * turned[2][b]);
}

void BETWEEN_KERNEL(const between_points_row *row, between_rows blocks) {
    int whole = whole_parts_below(row->begin), l = whole > row->lowest ? whole : row->lowest;
    for (; l + WIDTH <= row->tip_place; l += WIDTH) find_part(row, l, false, blocks);
    for (; l < row->end; l += WIDTH) find_part(row, l, true, blocks);
}
