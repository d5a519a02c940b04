/* Conjugate gradients for K u = f with symmetric Gauss-Seidel as preconditioner, in the form of Eisenstat (Efficient implementation of a class
   of preconditioned conjugate gradient methods, SIAM J. Sci. Stat. Comput. 2, 1981), and a coarse space. Needs no memory but for these and vectors. */
#ifndef TROCAR_CONJUGATE_GRADIENTS_H
#define TROCAR_CONJUGATE_GRADIENTS_H

#include <stdbool.h>
#include <suitesparse/cholmod.h>

#include "inverse/coarse_space.h"

/* Replaces u by one with |f - K u| <= tolerance |f|, or, without `coarse`, as near to that as rounding allows. The search begins at u, or at zero if that is nearer.
   `coarse` saves steps; NULL: none. `k`: the lower triangle of a symmetric positive definite matrix, columns with ascending rows. False, with a u from which another search may begin, without enough memory,
   where K proves not to be positive definite, where f is not finite, after so many steps, or where `coarse` leads no nearer. */
bool conjugate_gradients(const cholmod_sparse *k, coarse_space *coarse, double tolerance, int steps, const double *f, double *u);

#endif
