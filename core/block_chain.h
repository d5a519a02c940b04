/* Symmetric block tridiagonal systems, as they come from a chain of sections each coupled to its two neighbours. The
   matrix may be indefinite: rows are exchanged inside a block, never between blocks. */
#ifndef TROCAR_BLOCK_CHAIN_H
#define TROCAR_BLOCK_CHAIN_H

enum {
    CHAIN_BLOCKS = 64,       /* at most */
    CHAIN_ROWS = 15,         /* of a block */
    CHAIN_LD = 16,           /* the last column is padding for whole vectors and stays zero */
    CHAIN_HEAD = 3,          /* leading rows of each block, between which the inverse is wanted */
};

typedef double chain_block[CHAIN_ROWS][CHAIN_LD];
typedef double chain_rows[CHAIN_HEAD * CHAIN_BLOCKS]; /* one row, the head columns of every block */

typedef struct {
    int count;                                    /* blocks */
    chain_block diagonal[CHAIN_BLOCKS];           /* A_k; after chain_factor the inverse of its Schur complement S_k */
    chain_block upper[CHAIN_BLOCKS];              /* B_k, rows of block k, columns of k + 1; after chain_factor S_k^-1 B_k */
    chain_rows columns[2][CHAIN_ROWS];            /* scratch of chain_inverse_heads */
} block_chain;

/* Block elimination from the first block to the last, in place. 6 CHAIN_ROWS^3 operations a block. */
void chain_factor(block_chain *chain);

/* x: count x CHAIN_ROWS, right-hand side in, solution out. */
void chain_solve(const block_chain *chain, double (*x)[CHAIN_ROWS]);

/* Inverse between the leading CHAIN_HEAD rows of blocks >= first: out[(3 i + a) ld + 3 j + b] for blocks i, j. Uses the
   chain's scratch. */
void chain_inverse_heads(block_chain *chain, int first, double *out, int ld);

#endif
