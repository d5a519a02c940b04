/* A symmetric matrix of 3 x 3 blocks. Only blocks on and below the diagonal are stored, each contiguously, in double or single precision. */
#ifndef TROCAR_SYMMETRIC_BLOCKS_H
#define TROCAR_SYMMETRIC_BLOCKS_H

#include <stdbool.h>
#include <stddef.h>

typedef struct {
    int count;               /* rows of blocks */
    bool single;             /* true for float, false for double */
    void *numbers;           /* block (i, j), j <= i, row-major, has index i (i + 1) / 2 + j among the blocks */
} symmetric_blocks;

/* Returns the number of values, or of bytes, that `count` rows of blocks take. */
size_t symmetric_blocks_numbers(int count);
size_t symmetric_blocks_bytes(int count, bool single);

/* Writes block (row, column), which may be above the diagonal, to out: out[a * ld + b] is its entry (a, b). */
void symmetric_blocks_get(const symmetric_blocks *m, int row, int column, double *out, int ld);

/* Sets block (row, column), column <= row, from block[9], row-major. */
void symmetric_blocks_set(symmetric_blocks *m, int row, int column, const double block[9]);

#endif
