#include "tissue/factor_solve.h"

/* Allocates y before CHOLMOD would: up to version 3.0.14, CHOLMOD allocates y, then e, and checks only the second allocation. */
static bool allocate_first(const cholmod_factor *factor, const cholmod_dense *right, factor_solution *s, cholmod_common *common) {
    if (!s->y) s->y = cholmod_allocate_dense(factor->n, right->ncol, factor->n, factor->xtype, common);
    return s->y != NULL;
}

bool factor_solve(cholmod_factor *factor, cholmod_dense *right, factor_solution *s, cholmod_common *common) {
    return allocate_first(factor, right, s, common) && cholmod_solve2(CHOLMOD_A, factor, right, NULL, &s->x, NULL, &s->y, &s->e, common);
}

void factor_solution_free(factor_solution *s, cholmod_common *common) {
    cholmod_free_dense(&s->x, common);
    cholmod_free_dense(&s->y, common);
    cholmod_free_dense(&s->e, common);
}
