/* Linear complementarity with a symmetric positive definite matrix. */
#ifndef TROCAR_COMPLEMENTARITY_H
#define TROCAR_COMPLEMENTARITY_H

#include <stdbool.h>

/* Finds z >= 0 with w = q + A z >= -tolerance and z_i w_i = 0. A: n x n, symmetric positive definite, leading dimension ld. On entry, z_i > 0 marks the entries
   that are likely to be positive. `scratch`: n (n + 2) numbers. Returns false if the search does not converge or A is not positive definite. Uses block
   principal pivoting (Judice and Pires 1994): all entries with the wrong sign change sides at once. If that does not reduce their number, only the last of them
   does (Murty), which makes sure that the search terminates. */
bool complementarity_solve(int n, const double *a, int ld, const double *q, double tolerance, double *z, double *scratch);

#endif
