#include "linalg/row_triples.h"

#include <string.h>

#include "linalg/simd4.h"

_Static_assert(COLUMN_STEP == 2 * SIMD4_WIDTH, "a step is two vectors wide");

void column_ranges_add(column_ranges *c, int begin, int end) {
    if (end > begin) c->ranges[c->count].begin = begin, c->ranges[c->count++].end = (end + COLUMN_STEP - 1) / COLUMN_STEP * COLUMN_STEP;
}

void rows_clear(const column_ranges *c, double *to, int ld) {
    for (int a = 0; a < 3; a++)
        for (int k = 0; k < c->count; k++)
            memset(to + a * ld + c->ranges[k].begin, 0, (size_t)(c->ranges[k].end - c->ranges[k].begin) * sizeof *to);
}

void rows_copy(const column_ranges *c, const double *from, int from_ld, double *to, int ld) {
    for (int a = 0; a < 3; a++)
        for (int k = 0; k < c->count; k++) {
            int begin = c->ranges[k].begin;
            memcpy(to + a * ld + begin, from + a * from_ld + begin, (size_t)(c->ranges[k].end - begin) * sizeof *to);
        }
}

/* ---- products -------------------------------------------------------------------------------------------------------- */

/* Processes one step of columns. The 3 x 8 sums stay in registers while looping over the parts. */
static void add_step(int count, const row_triple *parts, int column, double *to, int ld) {
    simd4 sum[3][2];
    for (int a = 0; a < 3; a++)
        for (int h = 0; h < 2; h++) sum[a][h] = simd4_load(to + a * ld + column + h * SIMD4_WIDTH);
    for (int k = 0; k < count; k++)
        for (int m = 0; m < 3; m++) {
            const double *row = parts[k].rows + m * parts[k].ld + column;
            simd4 x = simd4_load(row), y = simd4_load(row + SIMD4_WIDTH);
            for (int a = 0; a < 3; a++) {
                simd4 f = simd4_all(parts[k].by.m[a][m]);
                sum[a][0] += f * x;
                sum[a][1] += f * y;
            }
        }
    for (int a = 0; a < 3; a++)
        for (int h = 0; h < 2; h++) simd4_store(to + a * ld + column + h * SIMD4_WIDTH, sum[a][h]);
}

void rows_add(const column_ranges *c, int count, const row_triple *parts, double *to, int ld) {
    for (int k = 0; k < c->count; k++)
        for (int column = c->ranges[k].begin; column < c->ranges[k].end; column += COLUMN_STEP) add_step(count, parts, column, to, ld);
}

void rows_interpolate(const column_ranges *c, int count, const weighted_triple *parts, double *to, int ld) {
    for (int k = 0; k < c->count; k++)
        for (int column = c->ranges[k].begin; column < c->ranges[k].end; column += SIMD4_WIDTH)
            for (int a = 0; a < 3; a++) {
                simd4 sum = simd4_all(0.0);
                for (int p = 0; p < count; p++) sum += simd4_all(parts[p].weight) * simd4_load(parts[p].rows + a * parts[p].ld + column);
                simd4_store(to + a * ld + column, sum);
            }
}

_Static_assert((int)BLOCK_LD == SIMD4_WIDTH, "a row of a block is one vector");

void block_sum(int count, const block_product *parts, double block[3][BLOCK_LD]) {
    simd4 sum[3] = {simd4_all(0.0), simd4_all(0.0), simd4_all(0.0)};
    for (int k = 0; k < count; k++)
        for (int m = 0; m < 3; m++) {
            const double *by = parts[k].by->m[m];
            simd4 row = {by[0], by[1], by[2], 0.0};
            for (int i = 0; i < 3; i++) sum[i] += simd4_all(parts[k].rows[i * parts[k].ld + m]) * row;
        }
    for (int i = 0; i < 3; i++) simd4_store(block[i], sum[i]);
}
