/* Conjugate gradients for K u = f with symmetric Gauss-Seidel as preconditioner, in the form of Eisenstat (Efficient implementation of a class
   of preconditioned conjugate gradient methods, SIAM J. Sci. Stat. Comput. 2, 1981). Needs no memory but for vectors. */
#ifndef TROCAR_CONJUGATE_GRADIENTS_H
#define TROCAR_CONJUGATE_GRADIENTS_H

#include <stdbool.h>
#include <suitesparse/cholmod.h>

/* Replaces u, where the search begins, by one with |f - K u| <= tolerance |f|, or as near to that as rounding allows. `k`: the lower triangle of a
   symmetric positive definite matrix, columns with ascending rows. False without enough memory, or where K is not definite. */
bool conjugate_gradients(const cholmod_sparse *k, double tolerance, const double *f, double *u);

#endif
