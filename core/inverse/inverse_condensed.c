#include "inverse/inverse.h"

#include <cblas.h>
#include <stdlib.h>
#include <string.h>
#include <threads.h>

#include "inverse/inverse_owner.h"
#include "inverse/condensed_cache.h"

/* The dense inverse between the nodes of a region of interest, K^-1_RR (condensation, Bro-Nielsen 1998). Other
   nodes are handled by a sparse inverse that is created on first use: a start with a cached inverse needs no factorisation. */
typedef struct {
    inverse shared;
    int count;               /* free nodes of the region */
    int *nodes;              /* count, in the order of the matrix */
    int *place;              /* node_count: index in `nodes`, or -1 */
    double *matrix;          /* 3 count square, full, m/N */
    mtx_t lock;              /* protects the next three members: worker, display and preparation may use them concurrently */
    inverse *rest;           /* NULL: not needed yet, or failed */
    trocar_status rest_status;
    report no_rest;          /* reason of the failure */
    int given_count, *given; /* nodes of the region as given */
} condensed_inverse;

/* ---- the rest of the body --------------------------------------------------------------------------------------------- */

static trocar_status factor_once(condensed_inverse *c, report *why) {
    return c->shared.tissue->factor ? TROCAR_OK : tissue_factor(c->shared.tissue, c->given_count, c->given, why);
}

/* Creates the sparse inverse once. A failure is not retried, because each attempt would take minutes. */
static trocar_status rest_of(condensed_inverse *c, inverse **rest, report *why) {
    mtx_lock(&c->lock);
    if (!c->rest && c->rest_status == TROCAR_OK) {
        c->rest_status = factor_once(c, &c->no_rest);
        if (c->rest_status == TROCAR_OK) c->rest_status = inverse_create_sparse(c->shared.tissue, SPARSE_CACHE, &c->rest, &c->no_rest);
    }
    trocar_status status = c->rest_status;
    *rest = c->rest;
    if (status != TROCAR_OK) *why = c->no_rest;
    mtx_unlock(&c->lock);
    return status;
}

static trocar_status condensed_prepare(inverse *inv, report *why) {
    inverse *rest;
    return rest_of((condensed_inverse *)inv, &rest, why);
}

static bool is_inside(const condensed_inverse *c, int count, const int *nodes) {
    for (int i = 0; i < count; i++)
        if (c->place[nodes[i]] < 0 && c->shared.tissue->dof[nodes[i]] >= 0) return false;
    return true;
}

static void look_up(const condensed_inverse *c, int row, int column, double *out, int ld) {
    size_t n = 3 * (size_t)c->count;
    bool zero = c->place[row] < 0 || c->place[column] < 0; /* in the region, hence fixed */
    const double *block = c->matrix + (zero ? 0 : (size_t)(3 * c->place[row]) * n + (size_t)(3 * c->place[column]));
    for (size_t a = 0; a < 3; a++)
        for (size_t b = 0; b < 3; b++) out[a * (size_t)ld + b] = zero ? 0.0 : block[a * n + b];
}

/* Copies blocks of the region; other blocks come from the sparse inverse. */
static trocar_status condensed_gather(inverse *inv, const inverse_blocks *blocks, report *why) {
    condensed_inverse *c = (condensed_inverse *)inv;
    if (!is_inside(c, blocks->row_count, blocks->rows) || !is_inside(c, blocks->column_count, blocks->columns)) {
        inverse *rest;
        trocar_status status = rest_of(c, &rest, why);
        return status == TROCAR_OK ? inverse_gather(rest, blocks, why) : status;
    }
    for (int i = 0; i < blocks->row_count; i++)
        for (int j = 0; j < blocks->column_count; j++)
            look_up(c, blocks->rows[i], blocks->columns[j], blocks->out + (size_t)(3 * i) * (size_t)blocks->ld + 3 * j, blocks->ld);
    return TROCAR_OK;
}

static void condensed_apply(inverse *inv, const double *force, double *displacement) {
    report why;
    bool forced = false;
    for (int i = 0; i < inv->tissue->dof_count && !forced; i++) forced = force[i] != 0.0;
    inverse *rest;
    if (forced && rest_of((condensed_inverse *)inv, &rest, &why) == TROCAR_OK) rest->owner->apply(rest, force, displacement);
    else memset(displacement, 0, (size_t)inv->tissue->dof_count * sizeof *force); /* no force, hence no displacement and no factorisation */
}

static void condensed_release(inverse *inv) {
    condensed_inverse *c = (condensed_inverse *)inv;
    inverse_free(c->rest);
    mtx_destroy(&c->lock);
    free(c->nodes);
    free(c->place);
    free(c->given);
    free(c->matrix);
}

static bool condensed_holds(const inverse *inv, int node) { return is_inside((const condensed_inverse *)inv, 1, &node); }

static const inverse_owner condensed_owner = {"condensed", condensed_gather, condensed_apply, condensed_prepare, condensed_release, NULL,
                                              condensed_holds, NULL};

/* ---- condensation ----------------------------------------------------------------------------------------------------- */

static int by_column(const void *a, const void *b) {
    const int *p = a, *q = b;
    return p[0] - q[0];
}

/* Sorts the region's nodes by their position in the factor. */
static bool order_nodes(condensed_inverse *c) {
    const tissue *t = c->shared.tissue;
    int (*ranked)[2] = malloc((size_t)(c->count + 1) * sizeof *ranked), found = 0;
    for (int i = 0; i < c->given_count && ranked; i++)
        if (t->dof[c->given[i]] >= 0) {
            ranked[found][0] = t->column[t->dof[c->given[i]] / 3];
            ranked[found++][1] = c->given[i];
        }
    if (ranked) qsort(ranked, (size_t)found, sizeof *ranked, by_column);
    for (int i = 0; i < found; i++) c->nodes[i] = ranked[i][1];
    free(ranked);
    return ranked != NULL;
}

/* Copies L_RR, dense. The region is eliminated last, so its columns of L have no other rows, and
   K^-1_RR = (L_RR L_RR^T)^-1. */
static bool copy_factor(condensed_inverse *c) {
    const tissue *t = c->shared.tissue;
    const cholmod_factor *f = t->factor;
    const int *super = f->super, *pi = f->pi, *px = f->px, *rows = f->s;
    size_t n = 3 * (size_t)c->count;
    int *index = malloc((size_t)t->dof_count * sizeof *index);
    if (!index) return false;
    for (int i = 0; i < t->dof_count; i++) index[i] = -1;
    for (int i = 0; i < c->count; i++)
        for (int a = 0; a < 3; a++) index[t->column[t->dof[c->nodes[i]] / 3] + a] = 3 * i + a;
    memset(c->matrix, 0, n * n * sizeof *c->matrix);
    for (int s = 0; s < (int)f->nsuper; s++)
        for (int column = super[s]; column < super[s + 1]; column++) {
            int row_count = pi[s + 1] - pi[s], skipped = column - super[s];
            const double *values = (const double *)f->x + px[s] + (size_t)skipped * (size_t)row_count;
            for (int r = skipped; r < row_count && index[column] >= 0; r++)
                c->matrix[(size_t)index[column] * n + (size_t)index[rows[pi[s] + r]]] = values[r];
        }
    free(index);
    return true;
}

/* Replaces L by (L L^T)^-1 in place, one block of columns at a time; columns to the left of a block are no longer needed. */
static bool invert_factor(double *matrix, size_t n, inverse_progress progress) {
    enum { BLOCK = 192 };
    double *x = malloc(n * BLOCK * sizeof *x);
    if (!x) return false;
    for (size_t first = 0; first < n; first += BLOCK) {
        size_t width = n - first < BLOCK ? n - first : BLOCK, left = n - first;
        const double *corner = matrix + first * n + first;
        memset(x, 0, left * width * sizeof *x);
        for (size_t j = 0; j < width; j++) x[j * left + j] = 1.0;
        cblas_dtrsm(CblasColMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, (int)left, (int)width, 1.0, corner, (int)n, x, (int)left);
        cblas_dtrsm(CblasColMajor, CblasLeft, CblasLower, CblasTrans, CblasNonUnit, (int)left, (int)width, 1.0, corner, (int)n, x, (int)left);
        for (size_t j = 0; j < width; j++) memcpy(matrix + (first + j) * n + first, x + j * left, left * sizeof *x);
        double rest = (double)(left - width) / (double)n;
        if (progress.show) progress.show("condensing the inverse", 1.0 - rest * rest * rest, progress.context);
    }
    free(x);
    for (size_t j = 0; j < n; j++)
        for (size_t i = j + 1; i < n; i++) matrix[i * n + j] = matrix[j * n + i];
    return true;
}

static trocar_status condense(condensed_inverse *c, inverse_progress progress, report *why) {
    if (progress.show) progress.show("factoring the stiffness matrix", 0.0, progress.context);
    trocar_status status = factor_once(c, why);
    if (progress.show) progress.show("factoring the stiffness matrix", 1.0, progress.context);
    if (status != TROCAR_OK) return status;
    bool done = order_nodes(c) && copy_factor(c) && invert_factor(c->matrix, 3 * (size_t)c->count, progress);
    return done ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory to condense the inverse");
}

/* Reads the matrix from the cache, or computes and caches it. */
static trocar_status fill(condensed_inverse *c, const char *directory, inverse_progress progress, report *notice, report *why) {
    condensed_cache cache = condensed_cache_find(directory, c->shared.tissue, c->given_count, c->given);
    cache_state found = condensed_cache_read(&cache, c->count, c->nodes, c->matrix);
    bool known = found == CACHE_READ;
    for (int i = 0; i < c->count && known; i++)
        known = c->nodes[i] >= 0 && c->nodes[i] < c->shared.tissue->mesh->node_count && c->shared.tissue->dof[c->nodes[i]] >= 0;
    if (known) {
        snprintf(notice->text, sizeof notice->text, "%d nodes, read from %.900s", c->count, cache.path);
        return TROCAR_OK;
    }
    trocar_status status = condense(c, progress, why);
    if (status != TROCAR_OK) return status;
    snprintf(notice->text, sizeof notice->text, "%d nodes, %s %.900s", c->count,
             found == CACHE_ABSENT ? "written to" : "damaged, rewritten to", cache.path);
    report unwritten;
    if (condensed_cache_write(&cache, c->count, c->nodes, c->matrix, &unwritten) != TROCAR_OK) *notice = unwritten;
    return TROCAR_OK;
}

trocar_status inverse_create_condensed(tissue *t, const condensed_region *region, inverse **created, report *notice, report *why) {
    int count = region->count;
    const int *nodes = region->nodes;
    condensed_inverse *c = calloc(1, sizeof *c);
    *created = c ? &c->shared : NULL;
    if (!c) return fail(why, TROCAR_NO_MEMORY, "no memory");
    mtx_init(&c->lock, mtx_plain);
    trocar_status status = inverse_init(&c->shared, &condensed_owner, t, why);
    size_t all = (size_t)t->mesh->node_count;
    for (int i = 0; i < count; i++) c->count += t->dof[nodes[i]] >= 0;
    size_t n = 3 * (size_t)c->count;
    c->given_count = count;
    c->given = malloc(((size_t)count + 1) * sizeof *c->given);
    c->nodes = malloc(((size_t)count + 1) * sizeof *c->nodes);
    c->place = malloc(all * sizeof *c->place);
    c->matrix = malloc((n * n + 1) * sizeof *c->matrix);
    if (status == TROCAR_OK && !(c->given && c->nodes && c->place && c->matrix))
        status = fail(why, TROCAR_NO_MEMORY, "no memory for the condensed inverse: %.1f GB for %d nodes; choose a smaller region_of_interest",
                      8e-9 * (double)n * (double)n, c->count);
    if (status == TROCAR_OK && c->count == 0)
        status = fail(why, TROCAR_BAD_INPUT, "inverse: condensed needs a region_of_interest with nodes that are not fixed");
    if (status == TROCAR_OK) {
        memcpy(c->given, nodes, (size_t)count * sizeof *nodes);
        status = fill(c, region->directory, region->progress, notice, why);
    }
    if (status != TROCAR_OK) {
        inverse_free(&c->shared);
        *created = NULL;
        return status;
    }
    for (size_t i = 0; i < all; i++) c->place[i] = -1;
    for (int i = 0; i < c->count; i++) c->place[c->nodes[i]] = i;
    return TROCAR_OK;
}
