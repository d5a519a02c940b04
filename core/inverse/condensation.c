#include "inverse/condensation.h"

#include <cblas.h>
#include <lapacke.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { WIDTH = 576 };        /* columns of a panel, whole blocks of 3 */

/* A lower triangular matrix in panels: columns [first, first + width), from the diagonal down. Zero above the diagonal. */
typedef struct {
    int first, width, rows;
    void *values;            /* rows x width, column-major; double, or float once it was made single */
} panel;

typedef struct {
    int count;
    panel *panels;
} triangle;

static void triangle_free(triangle *t) {
    for (int k = 0; k < t->count; k++) free(t->panels[k].values);
    free(t->panels);
}

static bool triangle_create(triangle *t, int n) {
    *t = (triangle){.count = (n + WIDTH - 1) / WIDTH};
    t->panels = calloc((size_t)t->count, sizeof *t->panels);
    bool created = t->panels != NULL;
    if (!created) t->count = 0;
    for (int k = 0; k < t->count && created; k++) {
        int first = k * WIDTH, rows = n - first, width = rows < WIDTH ? rows : WIDTH;
        t->panels[k] = (panel){first, width, rows, calloc((size_t)rows * (size_t)width, sizeof(double))};
        created = t->panels[k].values != NULL;
    }
    return created;
}

/* ---- from the factor -------------------------------------------------------------------------------------------------- */

static int by_column(const void *a, const void *b) {
    const int *p = a, *q = b;
    return p[0] - q[0];
}

/* The region's free nodes, sorted by their position in the factor. */
static bool order_nodes(const tissue *t, const condensed_region *region, int *nodes) {
    int (*ranked)[2] = malloc((size_t)(region->count + 1) * sizeof *ranked), found = 0;
    for (int i = 0; i < region->count && ranked; i++)
        if (t->dof[region->nodes[i]] >= 0) {
            ranked[found][0] = t->column[t->dof[region->nodes[i]] / 3];
            ranked[found++][1] = region->nodes[i];
        }
    if (ranked) qsort(ranked, (size_t)found, sizeof *ranked, by_column);
    for (int i = 0; i < found; i++) nodes[i] = ranked[i][1];
    free(ranked);
    return ranked != NULL;
}

/* Keeps only the supernodes with columns of the region (index >= 0), and gives the memory of the others back. */
static void keep_region(tissue *t, const int *index) {
    cholmod_factor *f = t->factor;
    const int *super = f->super, *pi = f->pi;
    int *px = f->px, kept = 0;
    double *x = f->x;
    for (int s = 0; s < (int)f->nsuper; s++) {
        int width = super[s + 1] - super[s], size = (pi[s + 1] - pi[s]) * width, inside = 0;
        for (int column = super[s]; column < super[s + 1]; column++) inside += index[column] >= 0;
        if (inside == 0) continue;
        memmove(x + kept, x + px[s], (size_t)size * sizeof *x);
        px[s] = kept;
        kept += size;
    }
    f->x = cholmod_realloc((size_t)kept, sizeof *x, x, &f->xsize, &t->common);
}

/* L_RR. The region is eliminated last, so that its columns of L have no other rows, and K^-1_RR = (L_RR L_RR^T)^-1. The factor
   is of no use afterwards. */
static bool take_corner(tissue *t, int count, const int *nodes, triangle *corner) {
    cholmod_factor *f = t->factor;
    const int *super = f->super, *pi = f->pi, *px = f->px, *rows = f->s;
    int *index = malloc((size_t)t->dof_count * sizeof *index);
    if (!index) return false;
    for (int i = 0; i < t->dof_count; i++) index[i] = -1;
    for (int i = 0; i < count; i++)
        for (int a = 0; a < 3; a++) index[t->column[t->dof[nodes[i]] / 3] + a] = 3 * i + a;
    keep_region(t, index);
    bool created = triangle_create(corner, 3 * count);
    for (int s = 0; s < (int)f->nsuper && created; s++)
        for (int column = super[s]; column < super[s + 1]; column++) {
            if (index[column] < 0) continue;
            int row_count = pi[s + 1] - pi[s], skipped = column - super[s];
            const double *values = (const double *)f->x + px[s] + (size_t)skipped * (size_t)row_count;
            panel *p = &corner->panels[index[column] / WIDTH];
            double *into = (double *)p->values + (size_t)(index[column] - p->first) * (size_t)p->rows;
            for (int r = skipped; r < row_count; r++) into[index[rows[pi[s] + r]] - p->first] = values[r];
        }
    free(index);
    return created;
}

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
static trocar_status invert_triangle(triangle *l, bool single, inverse_progress progress) {
    int n = l->panels[0].rows;
    size_t number = single ? sizeof(float) : sizeof(double);
    char *product = malloc((size_t)n * WIDTH * number);
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
static trocar_status multiply_triangle(const triangle *t, symmetric_blocks *inverse, inverse_progress progress) {
    size_t number = inverse->single ? sizeof(float) : sizeof(double);
    void *tile = malloc((size_t)WIDTH * WIDTH * number);
    trocar_status status = tile ? TROCAR_OK : TROCAR_NO_MEMORY;
    for (int i = 0; i < t->count && status == TROCAR_OK; i++)
        for (int j = 0; j <= i; j++) {
            const panel *p = &t->panels[i], *q = &t->panels[j];
            multiply(inverse->single, &(product_of){p->width, q->width, p->rows, CblasTrans, 1.0, 0.0}, p->values, p->rows,
                     (const char *)q->values + (size_t)(p->first - q->first) * number, q->rows, tile, WIDTH);
            for (int r = 0; r < p->width; r += 3)
                for (int c = 0; c < q->width && q->first + c <= p->first + r; c += 3) {
                    double block[9];
                    bool diagonal = q->first + c == p->first + r;
                    for (int k = 0; k < 9; k++) {
                        int row = k / 3, column = k % 3, swapped = diagonal && column > row; /* exactly symmetric */
                        int at = (c + (swapped ? row : column)) * WIDTH + r + (swapped ? column : row);
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

trocar_status condense(tissue *t, const condensed_region *region, int *nodes, symmetric_blocks *inverse, report *why) {
    inverse_progress progress = region->progress;
    triangle corner = {0};
    trocar_status status = inverse_factor(t, region->count, region->nodes, progress, why);
    if (status != TROCAR_OK) return status;
    bool taken = order_nodes(t, region, nodes) && take_corner(t, inverse->count, nodes, &corner);
    cholmod_free_factor(&t->factor, &t->common);
    for (int k = 0; k < corner.count && inverse->single && taken; k++) make_single(&corner.panels[k]);
    status = taken ? invert_triangle(&corner, inverse->single, progress) : TROCAR_NO_MEMORY;
    if (status == TROCAR_OK && !(inverse->numbers = malloc(symmetric_blocks_bytes(inverse->count, inverse->single)))) status = TROCAR_NO_MEMORY;
    if (status == TROCAR_OK) status = multiply_triangle(&corner, inverse, progress);
    triangle_free(&corner);
    if (status == TROCAR_NO_MEMORY)
        return fail(why, status, "no memory for the condensed inverse: %.1f GB for %d nodes; choose a smaller region_of_interest",
                    1e-9 * (double)symmetric_blocks_bytes(inverse->count, inverse->single), inverse->count);
    if (status != TROCAR_OK)
        return fail(why, status, "the condensed inverse cannot be represented in %s precision: check that the mesh is in metres and the Young's "
                    "moduli in Pa%s", inverse->single ? "single" : "double", inverse->single ? ", or set inverse_precision: double" : "");
    return TROCAR_OK;
}
