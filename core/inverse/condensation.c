#include "inverse/condensation.h"

#include <cblas.h>
#include <lapacke.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/memory.h"
#include "inverse/substructure.h"

/* ---- inversion -------------------------------------------------------------------------------------------------------- */

static void show(inverse_progress progress, double fraction) {
    if (progress.show) progress.show("condensing the inverse", fraction, progress.context);
}

/* Rounds a panel to floats, in place. */
static void make_single(panel *p) {
    size_t numbers = (size_t)p->rows * (size_t)p->width;
    char *at = p->values;
    for (size_t i = 0; i < numbers; i++) {
        double number;
        memcpy(&number, at + i * sizeof number, sizeof number);
        float rounded = (float)number;
        memcpy(at + i * sizeof rounded, &rounded, sizeof rounded);
    }
    void *smaller = realloc(p->values, numbers * sizeof(float));
    if (smaller) p->values = smaller;
}

/* What BLAS and LAPACK do in both precisions: C = alpha A B + beta C, and with the transpose of A; B <- B A and A <- A^-1, A lower triangular. */
typedef struct { int rows, columns, depth; CBLAS_TRANSPOSE transposed; double alpha, beta; } product_of;

static void multiply(bool single, const product_of *p, const void *a, int lda, const void *b, int ldb, void *c, int ldc) {
    if (single) cblas_sgemm(CblasColMajor, p->transposed, CblasNoTrans, p->rows, p->columns, p->depth, (float)p->alpha, a, lda, b, ldb, (float)p->beta, c, ldc);
    else cblas_dgemm(CblasColMajor, p->transposed, CblasNoTrans, p->rows, p->columns, p->depth, p->alpha, a, lda, b, ldb, p->beta, c, ldc);
}

static bool invert_corner(bool single, int n, void *a, int lda) {
    return (single ? LAPACKE_strtri_work(LAPACK_COL_MAJOR, 'L', 'N', n, a, lda) : LAPACKE_dtrtri_work(LAPACK_COL_MAJOR, 'L', 'N', n, a, lda)) == 0;
}

static void multiply_by_corner(bool single, int rows, int n, const void *a, int lda, void *b, int ldb) {
    if (single) cblas_strmm(CblasColMajor, CblasRight, CblasLower, CblasNoTrans, CblasNonUnit, rows, n, 1.0f, a, lda, b, ldb);
    else cblas_dtrmm(CblasColMajor, CblasRight, CblasLower, CblasNoTrans, CblasNonUnit, rows, n, 1.0, a, lda, b, ldb);
}

/* Replaces L by T = L^-1, from the last panel to the first. With the corner L_JJ of panel J and the rows L_BJ below it:
   T_JJ = L_JJ^-1, T_BJ = -T_BB L_BJ T_JJ. */
static trocar_status invert_triangle(panels *l, bool single, inverse_progress progress) {
    int n = l->panels[0].rows;
    size_t number = single ? sizeof(float) : sizeof(double);
    char *product = malloc((size_t)n * PANEL_WIDTH * number);
    trocar_status status = product ? TROCAR_OK : TROCAR_NO_MEMORY;
    for (int j = l->count - 1; j >= 0 && status == TROCAR_OK; j--) {
        panel *p = &l->panels[j];
        char *values = p->values;
        int below = p->rows - p->width;
        memset(product, 0, (size_t)below * (size_t)p->width * number);
        for (int k = j + 1; k < l->count; k++) {
            const panel *q = &l->panels[k];
            multiply(single, &(product_of){q->rows, p->width, q->width, CblasNoTrans, -1.0, 1.0}, q->values, q->rows,
                     values + (size_t)(q->first - p->first) * number, p->rows, product + (size_t)(below - q->rows) * number, below);
        }
        if (!invert_corner(single, p->width, values, p->rows)) status = TROCAR_BAD_INPUT;
        if (below > 0) multiply_by_corner(single, below, p->width, values, p->rows, product, below);
        for (size_t c = 0; c < (size_t)p->width; c++)
            memcpy(values + (c * (size_t)p->rows + (size_t)p->width) * number, product + c * (size_t)below * number, (size_t)below * number);
        double done = (double)p->rows / n;
        show(progress, 0.5 * done * done * done);
    }
    free(product);
    return status;
}

static bool is_positive(const double block[9]) {
    for (int a = 0; a < 3; a++)
        if (!(block[4 * a] > 0.0 && isfinite(block[4 * a]))) return false;
    return true;
}

/* K^-1 = T^T T. Its diagonal shows an overflow, or an underflow, in single precision. */
static trocar_status multiply_triangle(const panels *t, symmetric_blocks *inverse, inverse_progress progress) {
    size_t number = inverse->single ? sizeof(float) : sizeof(double);
    void *tile = malloc((size_t)PANEL_WIDTH * PANEL_WIDTH * number);
    trocar_status status = tile ? TROCAR_OK : TROCAR_NO_MEMORY;
    for (int i = 0; i < t->count && status == TROCAR_OK; i++)
        for (int j = 0; j <= i; j++) {
            const panel *p = &t->panels[i], *q = &t->panels[j];
            multiply(inverse->single, &(product_of){p->width, q->width, p->rows, CblasTrans, 1.0, 0.0}, p->values, p->rows,
                     (const char *)q->values + (size_t)(p->first - q->first) * number, q->rows, tile, PANEL_WIDTH);
            for (int r = 0; r < p->width; r += 3)
                for (int c = 0; c < q->width && q->first + c <= p->first + r; c += 3) {
                    double block[9];
                    bool diagonal = q->first + c == p->first + r;
                    for (int k = 0; k < 9; k++) {
                        int row = k / 3, column = k % 3, swapped = diagonal && column > row; /* exactly symmetric */
                        int at = (c + (swapped ? row : column)) * PANEL_WIDTH + r + (swapped ? column : row);
                        block[k] = inverse->single ? (double)((const float *)tile)[at] : ((const double *)tile)[at];
                    }
                    if (diagonal && !is_positive(block)) status = TROCAR_BAD_INPUT;
                    symmetric_blocks_set(inverse, (p->first + r) / 3, (q->first + c) / 3, block);
                }
            if (j == i) {
                double left = (double)(p->rows - p->width) / t->panels[0].rows;
                show(progress, 1.0 - 0.5 * left * left);
            }
        }
    free(tile);
    return status;
}

double condensation_bytes(int count) { return 72.0 * count * count; }

/* What the inversion needs at a time: the triangle, with what is made of a panel, then with the inverse and a tile of it. Each
   piece is rounded up to whole pages. */
static double inversion_bytes(int count, bool single) {
    double number = single ? sizeof(float) : sizeof(double), share = number / sizeof(double);
    double panel_product = 3.0 * count * PANEL_WIDTH * number, tile = (double)PANEL_WIDTH * PANEL_WIDTH * number;
    double rounding = 4096.0 * (3 + 3 * count / PANEL_WIDTH + 1);
    return rounding + share * panels_bytes(3 * count, 3 * count) + fmax(panel_product, (double)symmetric_blocks_bytes(count, single) + tile);
}

/* Predicted before the elimination begins, because a system that runs out of memory may end the process without a word. */
static trocar_status check_memory(const substructure *plan, double needed, report *why) {
    double available = memory_available();
    if (needed <= available) return TROCAR_OK;
    return fail(why, TROCAR_NO_MEMORY, "condensing the inverse of %d nodes to a region of %d takes %.3g GB of memory, and %.3g GB are available: choose a "
                "smaller region_of_interest, or a machine with more memory", plan->nodes, plan->region_count, 1e-9 * needed, 1e-9 * available);
}

/* L_RR, in double precision. */
static trocar_status find_corner(tissue *t, const condensed_region *region, int *nodes, panels *corner, double *needed, report *why) {
    substructure plan;
    *needed = 0.0;
    trocar_status status = tissue_stiffness(t, why);
    if (status == TROCAR_OK) status = substructure_plan(t, region->count, region->nodes, nodes, &plan, why);
    if (status == TROCAR_BAD_INPUT) *needed = INFINITY;
    if (status != TROCAR_OK) return status;
    *needed = fmax(plan.bytes, inversion_bytes(plan.region_count, region->single));
    status = check_memory(&plan, *needed, why);
    if (status == TROCAR_OK) status = substructure_eliminate(&plan, corner, region->progress, why);
    substructure_free(&plan);
    return status;
}

trocar_status condense(tissue *t, const condensed_region *region, int *nodes, symmetric_blocks *inverse, double *needed, report *why) {
    inverse_progress progress = region->progress;
    panels corner;
    trocar_status status = find_corner(t, region, nodes, &corner, needed, why);
    if (status != TROCAR_OK) return status;
    for (int k = 0; k < corner.count && inverse->single; k++) make_single(&corner.panels[k]);
    status = invert_triangle(&corner, inverse->single, progress);
    if (status == TROCAR_OK && !(inverse->numbers = malloc(symmetric_blocks_bytes(inverse->count, inverse->single)))) status = TROCAR_NO_MEMORY;
    if (status == TROCAR_OK) status = multiply_triangle(&corner, inverse, progress);
    panels_free(&corner);
    if (status == TROCAR_NO_MEMORY)
        return fail(why, status, "no memory for the condensed inverse: %.1f GB for %d nodes; choose a smaller region_of_interest",
                    1e-9 * (double)symmetric_blocks_bytes(inverse->count, inverse->single), inverse->count);
    if (status != TROCAR_OK)
        return fail(why, status, "the condensed inverse cannot be represented in %s precision: check that the mesh is in metres and the Young's "
                    "moduli in Pa%s", inverse->single ? "single" : "double", inverse->single ? ", or set inverse_precision: double" : "");
    return TROCAR_OK;
}
