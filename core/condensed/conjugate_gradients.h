/* Conjugate gradients for K u = f with a coarse space and symmetric Gauss-Seidel preconditioning, in Eisenstat's form (Efficient implementation of a class of
   preconditioned conjugate gradient methods, SIAM J. Sci. Stat. Comput. 2, 1981). Besides K and the coarse space, needs memory for only a few vectors. */
#ifndef TROCAR_CONJUGATE_GRADIENTS_H
#define TROCAR_CONJUGATE_GRADIENTS_H

#include <stdbool.h>
#include <suitesparse/cholmod.h>

#include "condensed/coarse_space.h"

/* Replaces u with a solution for which |f - K u| <= tolerance |f| or, without `coarse`, with one as accurate as rounding allows. Starts from u, or from zero if
   that has the smaller residual. `k` is the lower triangle of a symmetric positive definite matrix, with ascending rows in each column. `coarse`, which may be
   NULL, reduces the number of iterations; `steps` limits it. Returns false, with a valid starting point in u, if out of memory, if K turns out not to be
   positive definite, if f is not finite, after `steps` iterations, or if `coarse` does not help. */
bool conjugate_gradients(const cholmod_sparse *k, coarse_space *coarse, double tolerance, int steps, const double *f, double *u);

#endif
