/* Conjugate gradients for K u = f with a coarse space and symmetric Gauss-Seidel preconditioning, in the form of Eisenstat (Efficient implementation of
   a class of preconditioned conjugate gradient methods, SIAM J. Sci. Stat. Comput. 2, 1981). Apart from K and the coarse space, the method needs memory
   for only a few vectors. */
#ifndef TROCAR_CONJUGATE_GRADIENTS_H
#define TROCAR_CONJUGATE_GRADIENTS_H

#include <stdbool.h>
#include <suitesparse/cholmod.h>

#include "condensed/coarse_space.h"

/* Replaces u by a solution with |f - K u| <= tolerance |f| or, without `coarse`, as close as rounding allows. Starts from u, or from zero if that has the
   smaller residual. `coarse`, which may be NULL, reduces the number of iterations. `steps`: maximum number of iterations. `k`: lower triangle of a
   symmetric positive definite matrix, with ascending rows in each column. Returns false, with a valid starting point in u, if memory is exhausted, if K
   turns out not to be positive definite, if f is not finite, if `steps` is exceeded, or if `coarse` does not help. */
bool conjugate_gradients(const cholmod_sparse *k, coarse_space *coarse, double tolerance, int steps, const double *f, double *u);

#endif
