#include "remesh/row_triples.h"

#include <string.h>

#include "base/lanes.h"

_Static_assert(COLUMN_STEP == 2 * LANES, "a step is two vectors wide");

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

/* One step of columns: 3 x 8 sums stay in registers while the parts pass. */
static void add_step(int count, const row_triple *parts, int column, double *to, int ld) {
    lanes sum[3][2];
    for (int a = 0; a < 3; a++)
        for (int h = 0; h < 2; h++) sum[a][h] = lanes_load(to + a * ld + column + h * LANES);
    for (int k = 0; k < count; k++)
        for (int m = 0; m < 3; m++) {
            const double *row = parts[k].rows + m * parts[k].ld + column;
            lanes x = lanes_load(row), y = lanes_load(row + LANES);
            for (int a = 0; a < 3; a++) {
                lanes f = lanes_all(parts[k].by.m[a][m]);
                sum[a][0] += f * x;
                sum[a][1] += f * y;
            }
        }
    for (int a = 0; a < 3; a++)
        for (int h = 0; h < 2; h++) lanes_store(to + a * ld + column + h * LANES, sum[a][h]);
}

void rows_add(const column_ranges *c, int count, const row_triple *parts, double *to, int ld) {
    for (int k = 0; k < c->count; k++)
        for (int column = c->ranges[k].begin; column < c->ranges[k].end; column += COLUMN_STEP) add_step(count, parts, column, to, ld);
}

void rows_interpolate(const column_ranges *c, int count, const weighted_triple *parts, double *to, int ld) {
    for (int k = 0; k < c->count; k++)
        for (int column = c->ranges[k].begin; column < c->ranges[k].end; column += LANES)
            for (int a = 0; a < 3; a++) {
                lanes sum = lanes_all(0.0);
                for (int p = 0; p < count; p++) sum += lanes_all(parts[p].weight) * lanes_load(parts[p].rows + a * parts[p].ld + column);
                lanes_store(to + a * ld + column, sum);
            }
}
