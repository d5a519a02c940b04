/* The whole inverse as one matrix, as updated by the paper's methods. */
#ifndef TROCAR_ORACLES_DENSE_MATRIX_H
#define TROCAR_ORACLES_DENSE_MATRIX_H

#include <stdbool.h>

#include "inverse/inverse.h"

/* True if the inverse stores the whole matrix. */
bool is_dense(const inverse *inv);

/* Returns the matrix, dof_count square, in the tissue's numbering; release it with free(). NULL without memory. */
double *dense_matrix(inverse *inv);

#endif
