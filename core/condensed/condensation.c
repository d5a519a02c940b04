#include "condensed/condensation.h"

#include <cblas.h>
#include <lapacke.h>
#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "base/memory.h"
#include "base/team.h"
#include "condensed/substructure.h"

/* ---- inversion -------------------------------------------------------------------------------------------------------- */

static void show(inverse_progress progress, double fraction) {
    if (progress.show) progress.show("condensing the inverse", fraction, progress.context);
}

/* Converts a panel to single precision in place. */
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

/* BLAS and LAPACK operations in both precisions. multiply() computes C = alpha A B + beta C, optionally with A transposed. For a lower triangular A,
   multiply_by_corner() replaces B with B A, and invert_corner() replaces A with A^-1. */
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

/* The task of replacing panel J of L with panel J of T = L^-1: T_JJ = L_JJ^-1, T_BJ = -T_BB L_BJ T_JJ, where L_JJ is the diagonal block and L_BJ are the rows
   below it. */
typedef struct {
    const panels *l;
    int j;
    bool single;
    char *product;           /* T_BJ */
    bool *filled;            /* for each panel: true if its rows of T_BJ have nonzero entries */
} replacement;

/* Computes the rows of T_BJ that belong to one panel. The last panels go first, because their products take longest. */
static void multiply_rows(void *context, int index, int member) {
    (void)member;
    const replacement *r = context;
    int i = r->l->count - 1 - index;
    const panel *p = &r->l->panels[r->j], *beside = &r->l->panels[i];
    size_t number = r->single ? sizeof(float) : sizeof(double);
    int below = p->rows - p->width;
    char *rows = r->product + (size_t)(beside->first - p->first - p->width) * number;
    r->filled[i] = false;
    for (int k = r->j + 1; k <= i; k++) {
        const panel *q = &r->l->panels[k];
        if (!panels_filled(r->l, i, k) || !panels_filled(r->l, k, r->j)) continue;
        multiply(r->single, &(product_of){beside->width, p->width, q->width, CblasNoTrans, -1.0, r->filled[i] ? 1.0 : 0.0},
                 (const char *)q->values + (size_t)(beside->first - q->first) * number, q->rows,
                 (const char *)p->values + (size_t)(q->first - p->first) * number, p->rows, rows, below);
        r->filled[i] = true;
    }
    if (r->filled[i]) multiply_by_corner(r->single, beside->width, p->width, p->values, p->rows, rows, below);
}

static void copy_column(void *context, int column, int member) {
    (void)member;
    const replacement *r = context;
    const panel *p = &r->l->panels[r->j];
    size_t number = r->single ? sizeof(float) : sizeof(double), below = (size_t)(p->rows - p->width), c = (size_t)column;
    char *values = (char *)p->values + (c * (size_t)p->rows + (size_t)p->width) * number, *product = r->product + c * below * number;
    for (int i = r->j + 1; i < r->l->count; i++) {
        const panel *beside = &r->l->panels[i];
        size_t row = (size_t)(beside->first - p->first - p->width);
        if (r->filled[i]) memcpy(values + row * number, product + row * number, (size_t)beside->width * number);
    }
}

/* Replaces L with T = L^-1, from the last panel to the first. */
static trocar_status invert_triangle(panels *l, bool single, team *t, inverse_progress progress, trocar_error *why) {
    int n = l->panels[0].rows;
    replacement r = {.l = l, .single = single, .product = malloc((size_t)n * PANEL_WIDTH * (single ? sizeof(float) : sizeof(double)))};
    r.filled = calloc((size_t)l->count, sizeof *r.filled);
    trocar_status status = r.product && r.filled ? TROCAR_OK : TROCAR_NO_MEMORY;
    for (r.j = l->count - 1; r.j >= 0 && status == TROCAR_OK; r.j--) {
        const panel *p = &l->panels[r.j];
        if (!invert_corner(single, p->width, p->values, p->rows)) status = TROCAR_BAD_INPUT;
        team_run(t, l->count - 1 - r.j, multiply_rows, &r);
        team_run(t, p->width, copy_column, &r);
        for (int i = r.j + 1; i < l->count && l->filled; i++) l->filled[i * l->count + r.j] = r.filled[i];
        double done = (double)p->rows / n;
        show(progress, 0.5 * done * done * done);
        if (status == TROCAR_OK) status = inverse_go_on(progress, why);
    }
    free(r.product);
    free(r.filled);
    return status;
}

static bool is_positive(const double block[9]) {
    for (int a = 0; a < 3; a++)
        if (!(block[4 * a] > 0.0 && isfinite(block[4 * a]))) return false;
    return true;
}

typedef struct {
    const panels *t;
    symmetric_blocks *inverse;
    char *tiles;             /* scratch: a PANEL_WIDTH x PANEL_WIDTH matrix for each team member */
    atomic_bool failed, cancelled;
    inverse_progress progress;
    trocar_error *why;
} square;

/* Computes the block of K^-1 = T^T T between two panels. `index` numbers the blocks of the lower triangle row by row. */
static void multiply_panels(void *context, int index, int member) {
    square *s = context;
    if (atomic_load(&s->cancelled)) return;
    int i = (int)((sqrt(8.0 * index + 1.0) - 1.0) / 2.0), j = index - i * (i + 1) / 2;
    const panel *p = &s->t->panels[i], *q = &s->t->panels[j];
    bool single = s->inverse->single;
    size_t number = single ? sizeof(float) : sizeof(double);
    void *tile = s->tiles + (size_t)member * PANEL_WIDTH * PANEL_WIDTH * number;
    double beta = 0.0;
    for (int row = i, end; row < s->t->count; row = end) { /* [row, end): a run of panels where both factors have entries, or a run where not both do */
        bool filled = panels_filled(s->t, row, i) && panels_filled(s->t, row, j);
        for (end = row + 1; end < s->t->count && filled == (panels_filled(s->t, end, i) && panels_filled(s->t, end, j)); end++) continue;
        if (!filled) continue;
        int first = s->t->panels[row].first, depth = s->t->panels[end - 1].first + s->t->panels[end - 1].width - first;
        multiply(single, &(product_of){p->width, q->width, depth, CblasTrans, 1.0, beta}, (const char *)p->values + (size_t)(first - p->first) * number,
                 p->rows, (const char *)q->values + (size_t)(first - q->first) * number, q->rows, tile, PANEL_WIDTH);
        beta = 1.0;
    }
    if (beta == 0.0) memset(tile, 0, (size_t)PANEL_WIDTH * PANEL_WIDTH * number);
    for (int r = 0; r < p->width; r += 3)
        for (int c = 0; c < q->width && q->first + c <= p->first + r; c += 3) {
            double block[9];
            bool diagonal = q->first + c == p->first + r;
            for (int k = 0; k < 9; k++) {
                int row = k / 3, column = k % 3, swapped = diagonal && column > row; /* mirrors the lower triangle, to make the result exactly symmetric */
                int at = (c + (swapped ? row : column)) * PANEL_WIDTH + r + (swapped ? column : row);
                block[k] = single ? (double)((const float *)tile)[at] : ((const double *)tile)[at];
            }
            if (diagonal && !is_positive(block)) atomic_store(&s->failed, true);
            symmetric_blocks_set(s->inverse, (p->first + r) / 3, (q->first + c) / 3, block);
        }
    double left = (double)(p->rows - p->width) / s->t->panels[0].rows;
    if (member != 0) return;
    show(s->progress, 1.0 - 0.5 * left * left);
    if (inverse_go_on(s->progress, s->why) != TROCAR_OK) atomic_store(&s->cancelled, true);
}

/* Computes K^-1 = T^T T. Detects overflow and underflow in single precision by checking the diagonal. */
static trocar_status multiply_triangle(const panels *t, symmetric_blocks *inverse, team *team, inverse_progress progress, trocar_error *why) {
    size_t number = inverse->single ? sizeof(float) : sizeof(double);
    square s = {.t = t, .inverse = inverse, .progress = progress, .why = why};
    s.tiles = malloc((size_t)team_members(team) * PANEL_WIDTH * PANEL_WIDTH * number);
    if (!s.tiles) return TROCAR_NO_MEMORY;
    team_run(team, t->count * (t->count + 1) / 2, multiply_panels, &s);
    free(s.tiles);
    if (s.cancelled) return TROCAR_CANCELLED;
    show(progress, 1.0);
    return s.failed ? TROCAR_BAD_INPUT : TROCAR_OK;
}

double condensation_bytes(int count) { return 72.0 * count * count; }

/* Returns the inversion's peak memory (bytes). Besides the triangle, it first needs a copy of one panel, and later the inverse and its tiles. Allocations are
   rounded up to whole pages. */
static double inversion_bytes(int count, bool single, const team *t) {
    double number = single ? sizeof(float) : sizeof(double), share = number / sizeof(double);
    double panel_product = 3.0 * count * PANEL_WIDTH * number, tiles = (double)PANEL_WIDTH * PANEL_WIDTH * number * team_members(t);
    double rounding = 4096.0 * (3 + 3 * count / PANEL_WIDTH + 1);
    return rounding + share * panels_bytes(3 * count, 3 * count) + fmax(panel_product, (double)symmetric_blocks_bytes(count, single) + tiles);
}

/* Checks the memory before the elimination begins. Otherwise, a process that runs out of memory might be killed by the kernel without any message. */
static trocar_status check_memory(const substructure *plan, double needed, trocar_error *why) {
    double available = memory_available();
    if (needed <= available) return TROCAR_OK;
    return fail(why, TROCAR_NO_MEMORY, "condensing the inverse of %d nodes to a region of %d takes %.3g GB of memory, and %.3g GB are available: choose a "
                "smaller region_of_interest, or a machine with more memory", plan->nodes, plan->region_count, 1e-9 * needed, 1e-9 * available);
}

/* Computes the factor L_RR in double precision. */
static trocar_status find_corner(tissue *t, const condensed_region *region, team *team, int *nodes, panels *corner, double *needed, trocar_error *why) {
    substructure plan;
    *needed = 0.0;
    trocar_status status = tissue_stiffness(t, why);
    if (status == TROCAR_OK) status = substructure_plan(t, team, region->count, region->nodes, nodes, &plan, why);
    if (status == TROCAR_BAD_INPUT) *needed = INFINITY;
    if (status != TROCAR_OK) return status;
    *needed = fmax(plan.bytes, inversion_bytes(plan.region_count, region->single, team));
    status = check_memory(&plan, *needed, why);
    if (status == TROCAR_OK) status = substructure_eliminate(&plan, corner, region->progress, why);
    substructure_free(&plan);
    return status;
}

static trocar_status condense_with(team *team, tissue *t, const condensed_region *region, int *nodes, symmetric_blocks *inverse, double *needed,
                                   trocar_error *why) {
    inverse_progress progress = region->progress;
    panels corner;
    trocar_status status = find_corner(t, region, team, nodes, &corner, needed, why);
    if (status != TROCAR_OK) return status;
    for (int k = 0; k < corner.count && inverse->single; k++) make_single(&corner.panels[k]);
    status = invert_triangle(&corner, inverse->single, team, progress, why);
    if (status == TROCAR_OK && !(inverse->numbers = malloc(symmetric_blocks_bytes(inverse->count, inverse->single)))) status = TROCAR_NO_MEMORY;
    if (status == TROCAR_OK) status = multiply_triangle(&corner, inverse, team, progress, why);
    panels_free(&corner);
    if (status == TROCAR_CANCELLED) return status;
    if (status == TROCAR_NO_MEMORY)
        return fail(why, status, "no memory for the condensed inverse: %.1f GB for %d nodes; choose a smaller region_of_interest",
                    1e-9 * (double)symmetric_blocks_bytes(inverse->count, inverse->single), inverse->count);
    if (status != TROCAR_OK)
        return fail(why, status, "the condensed inverse cannot be represented in %s precision: check that the mesh is in metres and the Young's "
                    "moduli in Pa%s", inverse->single ? "single" : "double", inverse->single ? ", or set inverse_precision: double" : "");
    return TROCAR_OK;
}

/* Uses its own team of threads, because BLAS threads are slower for matrices as small as most fronts. Leaves the number of BLAS threads alone: it applies to
   the whole process, and several regions may be condensed at the same time. */
trocar_status condense(tissue *t, const condensed_region *region, int *nodes, symmetric_blocks *inverse, double *needed, trocar_error *why) {
    team *team = team_create(region->threads);
    trocar_status status = condense_with(team, t, region, nodes, inverse, needed, why);
    team_free(team);
    return status;
}
