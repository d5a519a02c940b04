/* The Cholesky factor of K: elimination order, factorisation, and the check that the body is constrained. */
#include <cblas.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/memory.h"
#include "tissue/blas.h"
#include "tissue/factor_solve.h"
#include "tissue/node_order.h"

/* ---- elimination order ---- */

static bool order_dofs(tissue *t, const bool *last, int *order) {
    int nodes = t->dof_count / 3, *by_node = malloc((size_t)nodes * sizeof *by_node);
    cholmod_sparse *graph = by_node ? node_graph(t) : NULL;
    bool done = graph && node_order(t, graph, last, by_node);
    for (int i = 0; i < t->dof_count && done; i++) order[i] = 3 * by_node[i / 3] + i % 3;
    cholmod_free_sparse(&graph, &t->common);
    free(by_node);
    return done;
}

/* Finds where each node's dofs are in the factor. They are contiguous, because their columns of K have the same pattern. */
static void find_columns(tissue *t) {
    const int *order = t->factor->Perm;
    for (int i = 0; i < t->dof_count; i += 3) t->column[order[i] / 3] = i;
}

static bool analyse(tissue *t, const bool *last) {
    int *order = malloc((size_t)t->dof_count * sizeof *order);
    if (order && order_dofs(t, last, order)) {
        t->common.nmethods = 1;
        t->common.method[0].ordering = CHOLMOD_GIVEN;
        t->factor = cholmod_analyze_p(t->stiffness, order, NULL, 0, &t->common);
    }
    free(order);
    if (t->factor) find_columns(t);
    return t->factor != NULL;
}

/* ---- factor ---- */

/* Estimates the ratio of the smallest to the largest eigenvalue of K by the Rayleigh quotient after two steps of inverse iteration. Rounding can hide a
   singular K from its pivots (for a body free to rotate about two nodes, the smallest was 7e-9 of the largest), but not from this quotient, which is then
   hardly above 1e-16. Returns a negative number if out of memory. */
static double least_stiffness(tissue *t) {
    int n = t->dof_count;
    double one[2] = {1, 0}, zero[2] = {0, 0}, quotient = -1.0;
    cholmod_dense *x = cholmod_zeros((size_t)n, 1, CHOLMOD_REAL, &t->common);
    cholmod_dense *force = cholmod_zeros((size_t)n, 1, CHOLMOD_REAL, &t->common);
    factor_solution next = {0};
    for (int i = 0; x && i < n; i++) ((double *)x->x)[i] = tissue_test_load(i);
    bool solved = x != NULL;
    for (int step = 0; step < 2 && solved; step++) {
        solved = factor_solve(t->factor, x, &next, &t->common);
        if (solved) cblas_daxpby(n, 1.0 / cblas_dnrm2(n, next.x->x, 1), next.x->x, 1, 0.0, x->x, 1);
    }
    if (solved && force && cholmod_sdmult(t->stiffness, 0, one, zero, x, force, &t->common))
        quotient = fabs(cblas_ddot(n, x->x, 1, force->x, 1)) / cholmod_norm_sparse(t->stiffness, 1, &t->common);
    factor_solution_free(&next, &t->common);
    cholmod_free_dense(&x, &t->common);
    cholmod_free_dense(&force, &t->common);
    return quotient;
}

trocar_status tissue_loose(trocar_error *why) {
    return fail(why, TROCAR_BAD_INPUT, "the fixed nodes do not constrain the whole body: name a surface or region "
                "under `fixed` that every part of the mesh is connected to");
}

/* Returns the memory needed for the factor, for the largest update of a supernode, and for K in elimination order. */
static double factor_bytes(tissue *t) {
    double numbers = (double)t->factor->xsize + (double)t->factor->maxcsize;
    return sizeof(double) * numbers + (sizeof(double) + sizeof(int)) * (double)cholmod_nnz(t->stiffness, &t->common);
}

/* Checks memory before the computation, because the kernel may kill a process that runs out of memory without any message. */
static trocar_status check_memory(tissue *t, trocar_error *why) {
    static const char remedy[] = "with inverse: condensed and needles that stay in the region_of_interest it is not needed";
    if (!t->factor || t->common.status == CHOLMOD_TOO_LARGE)
        return fail(why, TROCAR_BAD_INPUT, "the factor of the whole stiffness matrix (%d unknowns) has more than 2^31 entries, too many: %s",
                    t->dof_count, remedy);
    double needed = factor_bytes(t), available = memory_available();
    if (needed <= available) return TROCAR_OK;
    t->refused = needed;
    return fail(why, needed > memory_most() ? TROCAR_BAD_INPUT : TROCAR_NO_MEMORY, "the factor of the whole stiffness matrix (%d unknowns) takes %.3g GB of memory, and %.3g GB are available: %s",
                t->dof_count, 1e-9 * needed, 1e-9 * available, remedy);
}

static trocar_status factor(tissue *t, int count, const int *nodes, trocar_error *why) {
    bool *last = mark_free_nodes(t, count, nodes);
    if (count > 0) { /* a region of interest means a large mesh, for which more and narrower supernodes contain fewer zeros and save 5 % of the memory */
        static const double LEAST_FULL[3] = {0.2, 0.025, 0.0125};
        memcpy(t->common.zrelax, LEAST_FULL, sizeof LEAST_FULL);
    }
    bool analysed = last && analyse(t, last);
    free(last);
    if (analysed || t->common.status == CHOLMOD_TOO_LARGE) {
        trocar_status status = check_memory(t, why);
        if (status != TROCAR_OK) return status;
    }
    int levels = openmp_use_one_thread();
    bool factored = analysed && cholmod_factorize(t->stiffness, t->factor, &t->common);
    openmp_restore(levels);
    bool definite = factored && t->common.status != CHOLMOD_NOT_POSDEF;
    double least = definite ? least_stiffness(t) : 0.0;
    if (!factored || least < 0.0)
        return fail(why, TROCAR_NO_MEMORY, "no memory to factor the stiffness matrix (%d unknowns)", t->dof_count);
    return least >= LOOSE_BODY ? TROCAR_OK : tissue_loose(why);
}

trocar_status tissue_factor(tissue *t, int count, const int *nodes, trocar_error *why) {
    t->refused = 0.0;
    trocar_status status = tissue_stiffness(t, why);
    if (status == TROCAR_OK) status = factor(t, count, nodes, why);
    if (status != TROCAR_OK) cholmod_free_factor(&t->factor, &t->common);
    return status;
}
