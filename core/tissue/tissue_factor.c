/* The Cholesky factor of K: elimination order, factorisation, and the check that the body is constrained. */
#include <cblas.h>
#include <stdlib.h>
#include <string.h>

#include "tissue/tissue.h"

/* ---- elimination order ---- */

/* Sparsity pattern of K by nodes: the three dofs of a node have the same neighbours. */
static cholmod_sparse *node_graph(tissue *t) {
    const int *start = t->stiffness->p, *row = t->stiffness->i;
    size_t nodes = (size_t)t->dof_count / 3;
    cholmod_triplet *pairs = cholmod_allocate_triplet(nodes, nodes, cholmod_nnz(t->stiffness, &t->common) / 3 + 1, -1, CHOLMOD_PATTERN, &t->common);
    if (!pairs) return NULL;
    for (int j = 0; j < (int)nodes; j++)
        for (int k = start[3 * j]; k < start[3 * j + 1]; k++) {
            if (row[k] % 3 != 0) continue;
            ((int *)pairs->i)[pairs->nnz] = row[k] / 3;
            ((int *)pairs->j)[pairs->nnz++] = j;
        }
    cholmod_sparse *graph = cholmod_triplet_to_sparse(pairs, 0, &t->common);
    cholmod_free_triplet(&pairs, &t->common);
    return graph;
}

/* Nested dissection of the nodes; nodes marked `last` (indexed by first dof / 3) are moved to the end. The separators of the
   mesh still separate the remaining nodes. */
static bool order_dofs(tissue *t, const bool *last, int *order) {
    int nodes = t->dof_count / 3, filled = 0, *scratch = malloc(3 * (size_t)nodes * sizeof *scratch);
    cholmod_sparse *graph = scratch ? node_graph(t) : NULL;
    bool done = graph && cholmod_nested_dissection(graph, NULL, 0, scratch, scratch + nodes, scratch + 2 * nodes, &t->common) >= 0;
    for (int pass = 0; done && pass < 2; pass++)
        for (int i = 0; i < nodes; i++)
            for (int a = 0; a < 3 && last[scratch[i]] == (pass == 1); a++) order[filled++] = 3 * scratch[i] + a;
    cholmod_free_sparse(&graph, &t->common);
    free(scratch);
    return done;
}

/* Position of each node's dofs in the factor. They are contiguous, because their columns of K have the same pattern. */
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

/* Estimate of the ratio of the smallest to the largest eigenvalue of K: Rayleigh quotient after two steps of inverse iteration.
   Because of rounding a singular K may have inconspicuous pivots (7e-9 of the largest was observed for a body free to rotate
   about two nodes), but its quotient is not much above 1e-16. Negative if out of memory. */
static double least_stiffness(tissue *t) {
    int n = t->dof_count;
    double one[2] = {1, 0}, zero[2] = {0, 0}, quotient = -1.0;
    cholmod_dense *x = cholmod_ones((size_t)n, 1, CHOLMOD_REAL, &t->common);
    cholmod_dense *force = cholmod_zeros((size_t)n, 1, CHOLMOD_REAL, &t->common);
    for (int i = 0; x && i < n; i++) ((double *)x->x)[i] += 0.37 * (i % 7); /* not orthogonal to any rigid motion */
    for (int step = 0; step < 2 && x; step++) {
        cholmod_dense *next = cholmod_solve(CHOLMOD_A, t->factor, x, &t->common);
        cholmod_free_dense(&x, &t->common);
        x = next;
        if (x) cblas_dscal(n, 1.0 / cblas_dnrm2(n, x->x, 1), x->x, 1);
    }
    if (x && force && cholmod_sdmult(t->stiffness, 0, one, zero, x, force, &t->common))
        quotient = fabs(cblas_ddot(n, x->x, 1, force->x, 1)) / cholmod_norm_sparse(t->stiffness, 1, &t->common);
    cholmod_free_dense(&x, &t->common);
    cholmod_free_dense(&force, &t->common);
    return quotient;
}

static trocar_status factor(tissue *t, int count, const int *nodes, report *why) {
    static const double LOOSE = 1e-13;
    bool *last = calloc((size_t)t->dof_count / 3, sizeof *last);
    for (int i = 0; last && i < count; i++)
        if (t->dof[nodes[i]] >= 0) last[t->dof[nodes[i]] / 3] = true;
    if (count > 0) { /* a region of interest is for large meshes: more and narrower supernodes, with fewer zeros, save 5 % of the memory */
        static const double LEAST_FULL[3] = {0.2, 0.025, 0.0125};
        memcpy(t->common.zrelax, LEAST_FULL, sizeof LEAST_FULL);
    }
    bool factored = last && analyse(t, last) && cholmod_factorize(t->stiffness, t->factor, &t->common);
    free(last);
    bool definite = factored && t->common.status != CHOLMOD_NOT_POSDEF;
    double least = definite ? least_stiffness(t) : 0.0;
    if (!factored || least < 0.0)
        return fail(why, TROCAR_NO_MEMORY, "no memory to factor the stiffness matrix (%d unknowns)", t->dof_count);
    if (!(least >= LOOSE))
        return fail(why, TROCAR_BAD_INPUT, "the fixed nodes do not constrain the whole body: name a surface or region "
                    "under `fixed` that every part of the mesh is connected to");
    return TROCAR_OK;
}

trocar_status tissue_factor(tissue *t, int count, const int *nodes, report *why) {
    trocar_status status = tissue_stiffness(t, why);
    if (status == TROCAR_OK) status = factor(t, count, nodes, why);
    if (status != TROCAR_OK) cholmod_free_factor(&t->factor, &t->common);
    return status;
}
