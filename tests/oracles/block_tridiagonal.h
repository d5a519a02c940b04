/* Solves symmetric block tridiagonal systems, such as those of a chain of sections coupled to their neighbours. The matrix may be indefinite: rows are
   exchanged within blocks, but never between blocks. */
#ifndef TROCAR_BLOCK_TRIDIAGONAL_H
#define TROCAR_BLOCK_TRIDIAGONAL_H

enum {
    TRIDIAGONAL_BLOCKS = 64,       /* maximum number */
    TRIDIAGONAL_ROWS = 15,         /* per block */
    TRIDIAGONAL_LD = 16,           /* the last column is padded with zeros for vectorisation */
    TRIDIAGONAL_HEAD = 3,          /* leading rows of each block for which the inverse is computed */
};

typedef double tridiagonal_block[TRIDIAGONAL_ROWS][TRIDIAGONAL_LD];
typedef double tridiagonal_rows[TRIDIAGONAL_HEAD * TRIDIAGONAL_BLOCKS]; /* one row of the inverse, with the leading columns of every block */

typedef struct {
    int count;                                    /* blocks */
    tridiagonal_block diagonal[TRIDIAGONAL_BLOCKS];           /* A_k; after tridiagonal_factor, the inverse of its Schur complement S_k */
    tridiagonal_block upper[TRIDIAGONAL_BLOCKS];              /* B_k, rows of block k and columns of block k + 1; after tridiagonal_factor, S_k^-1 B_k */
    tridiagonal_rows columns[2][TRIDIAGONAL_ROWS];            /* scratch for tridiagonal_inverse_heads */
} block_tridiagonal;

/* Factorises in place by block elimination from the first block to the last, with 6 TRIDIAGONAL_ROWS^3 operations per block. */
void tridiagonal_factor(block_tridiagonal *chain);

/* Solves in place. x has shape count x TRIDIAGONAL_ROWS and holds the right-hand side on entry, the solution on return. */
void tridiagonal_solve(const block_tridiagonal *chain, double (*x)[TRIDIAGONAL_ROWS]);

/* Computes the inverse for the leading TRIDIAGONAL_HEAD rows of blocks >= first: out[(3 i + a) ld + 3 j + b] for blocks i, j. Uses the chain's scratch
   memory. */
void tridiagonal_inverse_heads(block_tridiagonal *chain, int first, double *out, int ld);

#endif
