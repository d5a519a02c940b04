/* Operations on three rows of a matrix (those of one node) over the columns of many nodes, four columns at a time. Columns are computed in whole vectors, so a
   few unused ones may be included. */
#ifndef TROCAR_ROW_TRIPLES_H
#define TROCAR_ROW_TRIPLES_H

#include "base/vec.h"

enum { MAX_COLUMN_RANGES = 3, COLUMN_STEP = 8, BLOCK_LD = 4 };

/* The columns in use, as ranges of whole steps. */
typedef struct {
    int count;
    struct { int begin, end; } ranges[MAX_COLUMN_RANGES];
} column_ranges;

void column_ranges_add(column_ranges *c, int begin, int end); /* `begin` is a multiple of COLUMN_STEP */

/* Three rows, `ld` apart, and the matrix that multiplies them. */
typedef struct {
    const double *rows;
    int ld;
    mat3 by;
} row_triple;

void rows_clear(const column_ranges *c, double *to, int ld);
void rows_copy(const column_ranges *c, const double *from, int from_ld, double *to, int ld);

/* Computes to += sum of by * rows. The terms are added in the order of `parts`, so the last bits of an entry do not depend on other entries. */
void rows_add(const column_ranges *c, int count, const row_triple *parts, double *to, int ld);

/* Computes to = sum of weight * rows, added in the order of `parts`. */
typedef struct {
    const double *rows;
    int ld;
    double weight;
} weighted_triple;
void rows_interpolate(const column_ranges *c, int count, const weighted_triple *parts, double *to, int ld);

/* Computes block = sum of rows * by over the first three columns, added in the order of `parts`; the fourth column of the block is zero. */
typedef struct {
    const double *rows;
    int ld;
    const mat3 *by;
} block_product;
void block_sum(int count, const block_product *parts, double block[3][BLOCK_LD]);

#endif
