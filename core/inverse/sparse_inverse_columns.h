/* Half of a solve: Y_j = L^-1 e_j for the three dofs of node j, with K = L L^T the supernodal factor. It is zero but on the
   way from j's column to the root of the elimination tree, and a block of the inverse is a product of two of them,
   K^-1_ij = Y_i^T Y_j, over the part of the ways that they share. See README.md, "Who owns the inverse". */
#ifndef TROCAR_SPARSE_INVERSE_COLUMNS_H
#define TROCAR_SPARSE_INVERSE_COLUMNS_H

#include "tissue/tissue.h"

enum { HALF_BLOCK = 32, PRODUCT_BLOCK = 64 }; /* nodes solved for at once; nodes on either side of a product at once */

typedef struct sparse_columns sparse_columns;

/* For this tissue's factor, which must outlive it. One to a thread. */
trocar_status sparse_columns_create(const tissue *t, sparse_columns **created, report *why);
void sparse_columns_free(sparse_columns *h);

/* Rows of Y of the node with first dof `dof`; and the most of all nodes. */
int sparse_columns_length(const sparse_columns *h, int dof);
int sparse_columns_longest(const sparse_columns *h);

/* Y of up to HALF_BLOCK nodes, y[i] column-major sparse_columns_length x 3. Allocates nothing. */
void sparse_columns_half_solve(sparse_columns *h, int count, const int *dofs, double *const *y);

/* out[(3 i + a) * ld + 3 j + b] = entry of K^-1 between dofs rows[i] + a and columns[j] + b, from their Y. At most
   PRODUCT_BLOCK of either. Allocates nothing. */
void sparse_columns_product(sparse_columns *h, int row_count, const int *rows, const double *const *row_y, int column_count, const int *columns,
                  const double *const *column_y, double *out, int ld);

#endif
