/* Says which blocks of K^-1 to compute, and where to write them. */
#ifndef TROCAR_INVERSE_BLOCKS_H
#define TROCAR_INVERSE_BLOCKS_H

typedef struct {
    int row_count;
    const int *rows;         /* node of each row of blocks */
    int column_count;
    const int *columns;
    double *out;             /* m/N, destination: entry (a, b) of the block for rows[i] and columns[j] goes to (3 i + a) * ld + 3 j + b */
    int ld;
} inverse_blocks;

#endif
