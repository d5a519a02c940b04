/* Blocks of K^-1 between nodes, and where to write them. */
#ifndef TROCAR_INVERSE_BLOCKS_H
#define TROCAR_INVERSE_BLOCKS_H

typedef struct {
    int row_count;
    const int *rows;         /* nodes */
    int column_count;
    const int *columns;
    double *out;             /* m/N, entry (3 i + a) * ld + 3 j + b */
    int ld;
} inverse_blocks;

#endif
