#include "inverse.h"

#include <cblas.h>
#include <stdlib.h>
#include <string.h>

/* What an owner of K^-1 can do; a sparse or a condensed owner adds its own table. */
typedef struct {
    void (*gather)(const inverse *, int, const int *, int, const int *, double *, int);
    void (*apply)(inverse *, const double *, double *);
    void (*release)(inverse *);
} inverse_owner;

struct inverse {
    const inverse_owner *owner;
    tissue *tissue;
    double *dense;           /* dof_count square, column-major */
    double *force, *displacement; /* dof_count: scratch of inverse_apply */
};

/* ---- dense owner ------------------------------------------------------------------------------------------------- */

static void dense_gather(const inverse *inv, int row_count, const int *rows, int column_count, const int *columns,
                         double *out, int ld) {
    size_t n = (size_t)inv->tissue->dof_count;
    const int *dof = inv->tissue->dof;
    for (int i = 0; i < row_count; i++)
        for (int j = 0; j < column_count; j++) {
            int row = dof[rows[i]], column = dof[columns[j]];
            const double *block = inv->dense + (size_t)(row < 0 ? 0 : row) * n + (column < 0 ? 0 : column);
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++)
                    out[(3 * i + a) * ld + 3 * j + b] = row < 0 || column < 0 ? 0.0 : block[(size_t)a * n + (size_t)b];
        }
}

static void dense_apply(inverse *inv, const double *force, double *displacement) {
    int n = inv->tissue->dof_count;
    cblas_dsymv(CblasColMajor, CblasUpper, n, 1.0, inv->dense, n, force, 1, 0.0, displacement, 1);
}

static void dense_release(inverse *inv) { free(inv->dense); }

static const inverse_owner dense_owner = {dense_gather, dense_apply, dense_release};

/* Solves K X = I block by block. */
static trocar_status dense_fill(inverse *inv, report *why) {
    enum { BLOCK = 96 };
    tissue *t = inv->tissue;
    size_t n = (size_t)t->dof_count;
    cholmod_dense *unit = cholmod_zeros(n, BLOCK, CHOLMOD_REAL, &t->common);
    cholmod_dense *solution = NULL, *y = NULL, *e = NULL;
    bool solved = unit != NULL;
    for (size_t first = 0; solved && first < n; first += BLOCK) {
        size_t width = n - first < BLOCK ? n - first : BLOCK;
        double *x = unit->x;
        memset(x, 0, n * BLOCK * sizeof *x);
        for (size_t c = 0; c < width; c++) x[c * n + first + c] = 1.0;
        solved = cholmod_solve2(CHOLMOD_A, t->factor, unit, NULL, &solution, NULL, &y, &e, &t->common);
        if (solved) memcpy(inv->dense + first * n, solution->x, n * width * sizeof(double));
    }
    cholmod_free_dense(&unit, &t->common);
    cholmod_free_dense(&solution, &t->common);
    cholmod_free_dense(&y, &t->common);
    cholmod_free_dense(&e, &t->common);
    return solved ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory to invert the stiffness matrix");
}

/* Rounding differs above and below the diagonal: make the matrix exactly symmetric. */
static void symmetrise(double *a, size_t n) {
    for (size_t j = 0; j < n; j++)
        for (size_t i = 0; i < j; i++) a[j * n + i] = a[i * n + j] = 0.5 * (a[j * n + i] + a[i * n + j]);
}

trocar_status inverse_create_dense(tissue *t, inverse **created, report *why) {
    size_t n = (size_t)t->dof_count;
    inverse *inv = calloc(1, sizeof *inv);
    *created = inv;
    if (!inv) return fail(why, TROCAR_NO_MEMORY, "no memory");
    inv->owner = &dense_owner;
    inv->tissue = t;
    inv->force = calloc(n, sizeof(double));
    inv->displacement = calloc(n, sizeof(double));
    inv->dense = malloc(n * n * sizeof(double));
    trocar_status status = TROCAR_OK;
    if (!inv->dense || !inv->force || !inv->displacement)
        status = fail(why, TROCAR_NO_MEMORY, "no memory for the dense inverse: %.1f GB for %d nodes; use a coarser mesh",
                      8e-9 * (double)n * (double)n, t->mesh->node_count);
    if (status == TROCAR_OK) status = dense_fill(inv, why);
    if (status == TROCAR_OK) {
        symmetrise(inv->dense, n);
        return TROCAR_OK;
    }
    inverse_free(inv);
    *created = NULL;
    return status;
}

/* ---- any owner --------------------------------------------------------------------------------------------------- */

void inverse_free(inverse *inv) {
    if (!inv) return;
    inv->owner->release(inv);
    free(inv->force);
    free(inv->displacement);
    free(inv);
}

void inverse_gather(const inverse *inv, int row_count, const int *rows, int column_count, const int *columns,
                    double *out, int ld) {
    inv->owner->gather(inv, row_count, rows, column_count, columns, out, ld);
}

void inverse_apply(inverse *inv, const vec3 *force, vec3 *displacement) {
    const tissue *t = inv->tissue;
    for (int i = 0; i < t->mesh->node_count; i++)
        if (t->dof[i] >= 0) memcpy(inv->force + t->dof[i], &force[i], sizeof force[i]);
    inv->owner->apply(inv, inv->force, inv->displacement);
    for (int i = 0; i < t->mesh->node_count; i++) {
        displacement[i] = v3(0, 0, 0);
        if (t->dof[i] >= 0) memcpy(&displacement[i], inv->displacement + t->dof[i], sizeof displacement[i]);
    }
}

const double *inverse_dense(const inverse *inv) { return inv->dense; }
const tissue *inverse_tissue(const inverse *inv) { return inv->tissue; }
