/* Solves with a CHOLMOD factor. */
#ifndef TROCAR_FACTOR_SOLVE_H
#define TROCAR_FACTOR_SOLVE_H

#include <stdbool.h>
#include <suitesparse/cholmod.h>

/* A solution and its workspace. Only the first solve allocates; later ones reuse the memory. Initialise with NULL. */
typedef struct { cholmod_dense *x, *y, *e; } factor_solution;

/* Solves A x = right, where x has the size of right. Returns false if out of memory. */
bool factor_solve(cholmod_factor *factor, cholmod_dense *right, factor_solution *s, cholmod_common *common);

void factor_solution_free(factor_solution *s, cholmod_common *common);

#endif
