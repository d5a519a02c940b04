/* Half-solves: Y_j = L^-1 e_j for the three dofs of node j, using the supernodal factor in K = L L^T. Y_j is nonzero only on the path from j's column to the
   root of the elimination tree. A block of the inverse is the product K^-1_ij = Y_i^T Y_j over the part that both paths share. See docs/mechanics.md, "Who
   owns the inverse". */
#ifndef TROCAR_SPARSE_INVERSE_COLUMNS_H
#define TROCAR_SPARSE_INVERSE_COLUMNS_H

#include "tissue/tissue.h"

enum { HALF_BLOCK = 32, PRODUCT_BLOCK = 64 }; /* most nodes: HALF_BLOCK, in one solve; PRODUCT_BLOCK, as rows or as columns of one product */

typedef struct sparse_columns sparse_columns;

/* Creates a solver for this tissue's factor; the factor must outlive it. Each thread needs its own solver. */
trocar_status sparse_columns_create(const tissue *t, sparse_columns **created, trocar_error *why);
void sparse_columns_free(sparse_columns *h);

/* sparse_columns_length returns how many rows of Y are stored for the node whose first dof is `dof`; sparse_columns_longest, the largest such number. */
int sparse_columns_length(const sparse_columns *h, int dof);
int sparse_columns_longest(const sparse_columns *h);

/* Computes Y for up to HALF_BLOCK nodes, given by their first dofs; y[i] is column-major, sparse_columns_length x 3. Does not allocate memory. */
void sparse_columns_half_solve(sparse_columns *h, int count, const int *dofs, double *const *y);

/* Nodes, given by their first dofs, with their Y. */
typedef struct {
    int count;
    const int *dofs;
    const double *const *y;
} half_solved;

/* Computes entries of K^-1 from half-solves: out[(3 i + a) * ld + 3 j + b] is the entry between dofs rows[i] + a and columns[j] + b. Takes at most
   PRODUCT_BLOCK rows and columns. Does not allocate memory. */
void sparse_columns_product(sparse_columns *h, const half_solved *rows, const half_solved *columns, double *out, int ld);

#endif
