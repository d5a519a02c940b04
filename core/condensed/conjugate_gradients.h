/* Conjugate gradients for K u = f with symmetric Gauss-Seidel preconditioning, in the form of Eisenstat (Efficient implementation of a class of preconditioned
   conjugate gradient methods, SIAM J. Sci. Stat. Comput. 2, 1981), and a coarse space. Besides K and the coarse space, it needs only a few vectors. */
#ifndef TROCAR_CONJUGATE_GRADIENTS_H
#define TROCAR_CONJUGATE_GRADIENTS_H

#include <stdbool.h>
#include <suitesparse/cholmod.h>

#include "condensed/coarse_space.h"

/* Replaces u by a solution with |f - K u| <= tolerance |f|, or, without `coarse`, as close as rounding allows. Starts from u, or from zero if the residual is
   then smaller. `coarse` reduces the number of steps; NULL: none. `k`: lower triangle of a symmetric positive definite matrix, columns with ascending rows.
   Returns false, leaving a valid starting point in u, if memory is missing, K proves not to be positive definite, f is not finite, the number of steps is
   exceeded, or `coarse` brings no progress. */
bool conjugate_gradients(const cholmod_sparse *k, coarse_space *coarse, double tolerance, int steps, const double *f, double *u);

#endif
