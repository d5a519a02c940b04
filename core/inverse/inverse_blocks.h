/* Describes which blocks of K^-1 between nodes to compute, and where to write them. */
#ifndef TROCAR_INVERSE_BLOCKS_H
#define TROCAR_INVERSE_BLOCKS_H

typedef struct {
    int row_count;
    const int *rows;         /* node of each row of blocks */
    int column_count;
    const int *columns;
    double *out;             /* m/N, destination: component (a, b) of the block of rows[i] and columns[j] is at (3 i + a) * ld + 3 j + b */
    int ld;
} inverse_blocks;

#endif
