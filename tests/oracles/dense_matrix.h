/* The whole inverse as a single matrix, which the paper's methods update. */
#ifndef TROCAR_ORACLES_DENSE_MATRIX_H
#define TROCAR_ORACLES_DENSE_MATRIX_H

#include <stdbool.h>

#include "inverse/inverse.h"

/* Returns whether the inverse stores the whole matrix. */
bool is_dense(const inverse *inv);

/* Returns the matrix, dof_count x dof_count, in the tissue's numbering, or NULL if out of memory. Release it with free(). */
double *dense_matrix(inverse *inv);

#endif
