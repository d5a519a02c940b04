#include "inverse/inverse.h"

#include <stdlib.h>
#include <string.h>

#include "inverse/inverse_owner.h"
#include "tissue/factor_solve.h"

/* The method of the paper (see core/README.md): the whole inverse as a dense matrix. */
typedef struct {
    inverse shared;
    double *dense;           /* dof_count x dof_count, column-major, with both triangles */
} dense_inverse;

static double *dense_of(inverse *inv) { return ((dense_inverse *)inv)->dense; }

static trocar_status dense_gather(inverse *inv, const inverse_blocks *blocks, trocar_error *why) {
    (void)why;
    size_t n = (size_t)inv->tissue->dof_count;
    const int *dof = inv->tissue->dof;
    for (int i = 0; i < blocks->row_count; i++)
        for (int j = 0; j < blocks->column_count; j++) {
            int row = dof[blocks->rows[i]], column = dof[blocks->columns[j]];
            const double *block = dense_of(inv) + (size_t)(row < 0 ? 0 : row) * n + (column < 0 ? 0 : column);
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++)
                    blocks->out[(3 * i + a) * blocks->ld + 3 * j + b] = row < 0 || column < 0 ? 0.0 : block[(size_t)a * n + (size_t)b];
        }
    return TROCAR_OK;
}

/* Reads only the columns of loaded nodes: needles load few nodes, but the whole matrix is hundreds of megabytes in size. */
static void dense_apply(inverse *inv, const double *force, double *restrict displacement) {
    size_t n = (size_t)inv->tissue->dof_count;
    memset(displacement, 0, n * sizeof *displacement);
    for (size_t j = 0; j < n; j++) {
        if (force[j] == 0.0) continue;
        const double *restrict column = dense_of(inv) + j * n;
        for (size_t i = 0; i < n; i++) displacement[i] += force[j] * column[i];
    }
}

static void dense_release(inverse *inv) { free(dense_of(inv)); }

static const inverse_owner dense_owner = {"dense", dense_gather, dense_apply, NULL, dense_release, NULL, NULL, NULL};

/* Solves K X = I, a block of columns at a time. */
static trocar_status dense_fill(tissue *t, double *dense, inverse_progress progress, trocar_error *why) {
    enum { BLOCK = 96 };
    size_t n = (size_t)t->dof_count;
    cholmod_dense *unit = cholmod_zeros(n, BLOCK, CHOLMOD_REAL, &t->common);
    factor_solution solution = {0};
    bool solved = unit != NULL;
    trocar_status status = TROCAR_OK;
    for (size_t first = 0; solved && status == TROCAR_OK && first < n; first += BLOCK) {
        size_t width = n - first < BLOCK ? n - first : BLOCK;
        double *x = unit->x;
        memset(x, 0, n * BLOCK * sizeof *x);
        for (size_t c = 0; c < width; c++) x[c * n + first + c] = 1.0;
        solved = factor_solve(t->factor, unit, &solution, &t->common);
        if (solved) memcpy(dense + first * n, solution.x->x, n * width * sizeof(double));
        status = inverse_go_on(progress, why);
    }
    cholmod_free_dense(&unit, &t->common);
    factor_solution_free(&solution, &t->common);
    return solved ? status : fail(why, TROCAR_NO_MEMORY, "no memory to invert the stiffness matrix");
}

/* Makes the matrix exactly symmetric. Without this, entries above and below the diagonal would differ by rounding errors. */
static void symmetrise(double *a, size_t n) {
    for (size_t j = 0; j < n; j++)
        for (size_t i = 0; i < j; i++) a[j * n + i] = a[i * n + j] = 0.5 * (a[j * n + i] + a[i * n + j]);
}

trocar_status inverse_create_dense(tissue *t, inverse_progress progress, inverse **created, trocar_error *why) {
    size_t n = (size_t)t->dof_count;
    dense_inverse *d = calloc(1, sizeof *d);
    *created = d ? &d->shared : NULL;
    if (!d) return fail(why, TROCAR_NO_MEMORY, "no memory");
    trocar_status status = inverse_init(&d->shared, &dense_owner, t, why);
    d->dense = malloc(n * n * sizeof(double));
    if (status == TROCAR_OK && !d->dense)
        status = fail(why, TROCAR_NO_MEMORY, "no memory for the dense inverse: %.1f GB for %d nodes; use a coarser mesh",
                      8e-9 * (double)n * (double)n, t->mesh->node_count);
    if (status == TROCAR_OK) status = dense_fill(t, d->dense, progress, why);
    if (status == TROCAR_OK) {
        symmetrise(d->dense, n);
        return TROCAR_OK;
    }
    inverse_free(&d->shared);
    *created = NULL;
    return status;
}
