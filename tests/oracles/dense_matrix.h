/* The whole inverse as one matrix, which the paper's methods update. */
#ifndef TROCAR_ORACLES_DENSE_MATRIX_H
#define TROCAR_ORACLES_DENSE_MATRIX_H

#include <stdbool.h>

#include "inverse/inverse.h"

/* Does the owner keep it all? */
bool is_dense(const inverse *inv);

/* dof_count square, in the numbering of the tissue, for free(). NULL without memory. */
double *dense_matrix(inverse *inv);

#endif
