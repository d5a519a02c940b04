/* Let M = G + C for all attachments, and L L^T = M. Let c_i = P^T K^-1 e_i be the displacements of the rows under unit forces on node i, and y_i = L^-1 c_i.
   Let V = L^-1 R, with the orthonormal basis Q = V T^-1, where T^T T = V^T V. Then inverse(i, j) = K^-1(i, j) - z_i^T z_j, where z_i = y_i - Q Q^T y_i. The
   response to displacements d of the rows is df = -L^-T z and q = T^-1 Q^T y, where y = L^-1 d and z = y - Q Q^T y. For the most recently used nodes, c_i, z_i,
   Q^T y_i and the blocks are cached. */
#include "inverse/inverse_attached.h"

#include <cblas.h>
#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "inverse/block_cache.h"
#include "inverse/inverse_owner.h"

enum { BATCH = 32, TILE = 64 };                     /* most nodes: BATCH, in one solve; TILE, as rows or as columns of one product */
static const double CACHE = 96e6;                   /* bytes, size of the cache for c_i, z_i and Q^T y_i */
enum { LEAST_NODES = 2 * TILE, MOST_NODES = 1024 }; /* minimum and maximum number of cached nodes */

typedef struct { uint64_t id; int first, rows; } placed;

typedef struct {
    inverse shared;
    inverse *base;
    int row_count, motion_count, placed_count;
    placed *placed;
    attached_row *rows;
    int *corner;             /* [row_count][4], index in `nodes` of each corner of the rows' tetrahedra */
    int node_count, *nodes;  /* all nodes of the rows' tetrahedra, without duplicates */
    double *between;         /* the matrix C, row_count x row_count, column-major */
    double *factor;          /* the matrix L, row_count x row_count, column-major */
    double *basis;           /* the matrix Q, row_count x motion_count */
    double *triangle;        /* the upper triangular matrix T, motion_count x motion_count */
    lru slots;
    double *kept;            /* for each slot: c, z and Q^T y, with 3 columns each */
    block_cache blocks;
    double *batch, *columns; /* scratch; batch: blocks between BATCH nodes and all of `nodes`; columns: 3 BATCH columns, each with one entry per row and
                                motion */
    double *left, *right, *tile; /* scratch; left and right: 3 TILE columns each, with one entry per row; tile: a 3 TILE x 3 TILE matrix */
    double *moved, *sum;     /* scratch for apply; moved: one entry per row and per motion; sum: dof_count entries */
} attached_inverse;

static size_t slot_size(const attached_inverse *a) { return 3 * (2 * (size_t)a->row_count + (size_t)a->motion_count); }
static double *slot_of(const attached_inverse *a, int node) { return a->kept + (size_t)a->slots.slot[node] * slot_size(a); }
static double *z_of(const attached_inverse *a, int node) { return slot_of(a, node) + 3 * (size_t)a->row_count; }
static double *moved_of(const attached_inverse *a, int node) { return slot_of(a, node) + 6 * (size_t)a->row_count; }

/* ---- what is kept of nodes ------------------------------------------------------------------------------------------------ */

/* Computes c for up to BATCH nodes. Writes 3 columns per node, with one entry per row, to `out`. */
static trocar_status find_c(attached_inverse *a, int count, const int *nodes, double *out, trocar_error *why) {
    int ld = 3 * a->node_count;
    trocar_status status = inverse_gather(a->base, &(inverse_blocks){count, nodes, a->node_count, a->nodes, a->batch, ld}, why);
    if (status != TROCAR_OK) return status;
    for (int k = 0; k < 3 * count; k++) {
        const double *given = a->batch + (size_t)k * (size_t)ld;
        double *column = out + (size_t)k * (size_t)a->row_count;
        for (int i = 0; i < a->row_count; i++) {
            const attached_row *row = &a->rows[i];
            column[i] = 0.0;
            for (int c = 0; c < 4 && row->tet >= 0; c++) {
                const double *u = given + 3 * a->corner[4 * i + c];
                column[i] += row->weights[c] * (row->direction.x * u[0] + row->direction.y * u[1] + row->direction.z * u[2]);
            }
        }
    }
    return TROCAR_OK;
}

/* For `count` columns, replaces y with z in place, and writes Q^T y to `moved`. */
static void project(const attached_inverse *a, int count, double *y, double *moved) {
    int n = a->row_count, m = a->motion_count;
    if (m == 0) return;
    cblas_dgemm(CblasColMajor, CblasTrans, CblasNoTrans, m, count, n, 1.0, a->basis, n, y, n, 0.0, moved, m);
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasNoTrans, n, count, m, -1.0, a->basis, n, moved, m, 1.0, y, n);
}

static trocar_status keep(attached_inverse *a, int count, const int *nodes, trocar_error *why) {
    size_t n = (size_t)a->row_count, m = (size_t)a->motion_count;
    double *y = a->columns, *moved = y + 3 * BATCH * n;
    trocar_status status = find_c(a, count, nodes, y, why);
    if (status != TROCAR_OK) return status;
    for (int k = 0; k < count; k++) {
        lru_claim(&a->slots, nodes[k]);
        memcpy(slot_of(a, nodes[k]), y + 3 * (size_t)k * n, 3 * n * sizeof *y);
    }
    cblas_dtrsm(CblasColMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, (int)n, 3 * count, 1.0, a->factor, (int)n, y, (int)n);
    project(a, 3 * count, y, moved);
    for (int k = 0; k < count; k++) {
        memcpy(z_of(a, nodes[k]), y + 3 * (size_t)k * n, 3 * n * sizeof *y);
        memcpy(moved_of(a, nodes[k]), moved + 3 * (size_t)k * m, 3 * m * sizeof *moved);
    }
    return TROCAR_OK;
}

/* Makes sure that all these nodes, at most LEAST_NODES, are cached. */
static trocar_status keep_all(attached_inverse *a, int count, const int *nodes, trocar_error *why) {
    int missing[BATCH], found = 0;
    trocar_status status = TROCAR_OK;
    for (int i = 0; i < count; i++) lru_touch(&a->slots, nodes[i]);
    for (int i = 0; i < count && status == TROCAR_OK; i++) {
        bool listed = a->slots.slot[nodes[i]] >= 0;
        for (int k = 0; k < found; k++) listed |= missing[k] == nodes[i];
        if (!listed) missing[found++] = nodes[i];
        if (found == BATCH) status = keep(a, found, missing, why), found = 0;
    }
    return found > 0 && status == TROCAR_OK ? keep(a, found, missing, why) : status;
}

/* ---- blocks ------------------------------------------------------------------------------------------------------------- */

static trocar_status compute_tile(void *context, const inverse_blocks *b, trocar_error *why) {
    attached_inverse *a = context;
    size_t n = (size_t)a->row_count, column = 3 * n * sizeof *a->left;
    int both[2 * TILE];
    memcpy(both, b->rows, (size_t)b->row_count * sizeof *both);
    memcpy(both + b->row_count, b->columns, (size_t)b->column_count * sizeof *both);
    trocar_status status = keep_all(a, b->row_count + b->column_count, both, why);
    if (status == TROCAR_OK) status = inverse_gather(a->base, b, why);
    if (status != TROCAR_OK) return status;
    for (int i = 0; i < b->row_count; i++) memcpy(a->left + 3 * (size_t)i * n, z_of(a, b->rows[i]), column);
    for (int j = 0; j < b->column_count; j++) memcpy(a->right + 3 * (size_t)j * n, z_of(a, b->columns[j]), column);
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasTrans, 3 * b->row_count, 3 * b->column_count, (int)n, -1.0, a->left, (int)n, a->right, (int)n,
                1.0, b->out, b->ld);
    return TROCAR_OK;
}

static trocar_status attached_gather(inverse *inv, const inverse_blocks *blocks, trocar_error *why) {
    attached_inverse *a = (attached_inverse *)inv;
    if (a->row_count == 0) return inverse_gather(a->base, blocks, why);
    return block_cache_gather(&a->blocks, &(block_source){compute_tile, a, a->tile, TILE}, blocks, why);
}

/* u = K^-1 (f + P df) */
static void attached_apply(inverse *inv, const double *force, double *displacement) {
    attached_inverse *a = (attached_inverse *)inv;
    const tissue *t = inv->tissue;
    size_t n = (size_t)a->row_count;
    double *d = a->moved;
    inverse_apply_locked(a->base, force, displacement);
    if (n == 0) return;
    for (size_t i = 0; i < n; i++) {
        d[i] = 0.0;
        for (int c = 0; c < 4 && a->rows[i].tet >= 0; c++) {
            int dof = t->dof[a->nodes[a->corner[4 * i + (size_t)c]]];
            if (dof >= 0) d[i] += a->rows[i].weights[c] * v3_dot(a->rows[i].direction, v3(displacement[dof], displacement[dof + 1], displacement[dof + 2]));
        }
    }
    cblas_dtrsv(CblasColMajor, CblasLower, CblasNoTrans, CblasNonUnit, (int)n, a->factor, (int)n, d, 1);
    project(a, 1, d, d + n);
    cblas_dtrsv(CblasColMajor, CblasLower, CblasTrans, CblasNonUnit, (int)n, a->factor, (int)n, d, 1);
    memcpy(a->sum, force, (size_t)t->dof_count * sizeof *a->sum);
    for (size_t i = 0; i < n; i++)
        for (int c = 0; c < 4 && a->rows[i].tet >= 0; c++) {
            int dof = t->dof[a->nodes[a->corner[4 * i + (size_t)c]]];
            const double along[] = {a->rows[i].direction.x, a->rows[i].direction.y, a->rows[i].direction.z};
            for (int k = 0; k < 3 && dof >= 0; k++) a->sum[dof + k] -= a->rows[i].weights[c] * d[i] * along[k];
        }
    inverse_apply_locked(a->base, a->sum, displacement);
}

static trocar_status attached_prepare(inverse *inv, trocar_error *why) { return inverse_prepare(((attached_inverse *)inv)->base, why); }
static bool attached_holds(const inverse *inv, int node) { return inverse_holds(((const attached_inverse *)inv)->base, node); }

static bool attached_prefetches(const inverse *inv) {
    const attached_inverse *a = (const attached_inverse *)inv;
    return a->row_count > 0 || inverse_prefetches(a->base);
}

/* Each node takes three solves with L. */
static int attached_slice(const inverse *inv) {
    const double AT_ONCE = 1.5e7; /* number of multiplications that take about 2 ms */
    const attached_inverse *a = (const attached_inverse *)inv;
    int beneath = inverse_slice(a->base);
    double nodes = AT_ONCE / (3.0 * (double)a->row_count * (double)a->row_count);
    return nodes >= beneath ? beneath : nodes > 1.0 ? (int)nodes : 1;
}

/* ---- attaching ------------------------------------------------------------------------------------------------------------ */

static void detach_all(attached_inverse *a) {
    free(a->placed);
    free(a->rows);
    free(a->corner);
    free(a->nodes);
    free(a->between);
    free(a->factor);
    free(a->basis);
    free(a->triangle);
    free(a->kept);
    free(a->batch);
    free(a->columns);
    free(a->left);
    free(a->right);
    free(a->tile);
    free(a->moved);
    free(a->sum);
    lru_free(&a->slots);
    block_cache_free(&a->blocks);
    *a = (attached_inverse){.shared = a->shared, .base = a->base};
}

static void attached_release(inverse *inv) { detach_all((attached_inverse *)inv); }

static const inverse_owner attached_owner = {"attached", attached_gather, attached_apply, attached_prepare, attached_release, attached_prefetches,
                                             attached_holds, attached_slice};

trocar_status inverse_create_attached(inverse *base, inverse **created, trocar_error *why) {
    attached_inverse *a = calloc(1, sizeof *a);
    *created = a ? &a->shared : NULL;
    if (!a) return fail(why, TROCAR_NO_MEMORY, "no memory");
    a->base = base;
    trocar_status status = inverse_init(&a->shared, &attached_owner, base->tissue, why);
    if (status == TROCAR_OK) return TROCAR_OK;
    inverse_free(&a->shared);
    *created = NULL;
    return status;
}

/* Copies the attachments' descriptions, and lists the nodes of their tetrahedra. Returns false if out of memory. */
static bool place_all(attached_inverse *a, int count, const attachment *things) {
    const mesh *m = a->shared.tissue->mesh;
    int *place = malloc((size_t)m->node_count * sizeof *place);
    for (int i = 0; i < count; i++) a->row_count += things[i].row_count, a->motion_count += things[i].motion_count;
    size_t n = (size_t)a->row_count, q = (size_t)a->motion_count;
    a->placed = malloc((size_t)count * sizeof *a->placed);
    a->rows = malloc(n * sizeof *a->rows);
    a->corner = calloc(4 * n, sizeof *a->corner);
    a->nodes = malloc(4 * n * sizeof *a->nodes);
    a->between = calloc(n * n, sizeof *a->between);
    a->factor = calloc(n * n, sizeof *a->factor);
    a->basis = calloc(n * q + 1, sizeof *a->basis);
    a->triangle = calloc(q * q + 1, sizeof *a->triangle);
    if (!(place && a->placed && a->rows && a->corner && a->nodes && a->between && a->factor && a->basis && a->triangle)) {
        free(place);
        return false;
    }
    for (int i = 0; i < m->node_count; i++) place[i] = -1;
    for (int t = 0, first = 0; t < count; first += things[t++].row_count) {
        memcpy(a->rows + first, things[t].rows, (size_t)things[t].row_count * sizeof *a->rows);
        a->placed[a->placed_count++] = (placed){things[t].id, first, things[t].row_count};
    }
    for (size_t i = 0; i < n; i++)
        for (int c = 0; c < 4 && a->rows[i].tet >= 0; c++) {
            int node = m->tets[a->rows[i].tet][c];
            if (a->rows[i].weights[c] == 0.0) continue; /* the point is at a node or on a face */
            if (place[node] < 0) a->nodes[place[node] = a->node_count++] = node;
            a->corner[4 * i + (size_t)c] = place[node];
        }
    free(place);
    return true;
}

static bool allocate_caches(attached_inverse *a) {
    size_t n = (size_t)a->row_count, nodes = (size_t)a->shared.tissue->mesh->node_count;
    double room = CACHE / (8.0 * (double)slot_size(a));
    size_t slots = room > MOST_NODES ? MOST_NODES : room < LEAST_NODES ? LEAST_NODES : (size_t)room;
    a->kept = malloc(slots * slot_size(a) * sizeof *a->kept);
    a->batch = malloc(3 * BATCH * 3 * ((size_t)a->node_count + 1) * sizeof *a->batch);
    a->columns = malloc(3 * BATCH * (n + (size_t)a->motion_count) * sizeof *a->columns);
    a->left = malloc(3 * TILE * n * sizeof *a->left);
    a->right = malloc(3 * TILE * n * sizeof *a->right);
    a->tile = malloc(sizeof(double[9 * TILE * TILE]));
    a->moved = malloc((n + (size_t)a->motion_count) * sizeof *a->moved);
    a->sum = malloc((size_t)a->shared.tissue->dof_count * sizeof *a->sum);
    return lru_create(&a->slots, nodes, slots) && block_cache_create(&a->blocks, (int)nodes) && a->kept && a->batch && a->columns && a->left && a->right
        && a->tile && a->moved && a->sum;
}

static const placed *find_placed(const attached_inverse *a, uint64_t id) {
    for (int i = 0; i < a->placed_count; i++)
        if (a->placed[i].id == id) return &a->placed[i];
    return NULL;
}

/* Copies the entries of C between attachments that existed before. */
static void copy_between(attached_inverse *a, const attached_inverse *before) {
    size_t n = (size_t)a->row_count, old = (size_t)before->row_count;
    for (int s = 0; s < a->placed_count; s++)
        for (int t = 0; t < a->placed_count; t++) {
            const placed *from = find_placed(before, a->placed[s].id), *to = find_placed(before, a->placed[t].id);
            for (int j = 0; from && to && j < a->placed[t].rows; j++)
                memcpy(a->between + (size_t)(a->placed[t].first + j) * n + (size_t)a->placed[s].first,
                       before->between + (size_t)(to->first + j) * old + (size_t)from->first, (size_t)a->placed[s].rows * sizeof *a->between);
        }
}

/* Computes the entries of C between a new attachment and all attachments, from c for the nodes of its rows. */
static trocar_status find_between(attached_inverse *a, const placed *thing, trocar_error *why) {
    size_t n = (size_t)a->row_count;
    bool *own = calloc((size_t)a->node_count + 1, sizeof *own);
    if (!own) return fail(why, TROCAR_NO_MEMORY, "no memory for a resting needle");
    for (int i = thing->first; i < thing->first + thing->rows; i++)
        for (int c = 0; c < 4 && a->rows[i].tet >= 0; c++) own[a->corner[4 * i + c]] |= a->rows[i].weights[c] != 0.0;
    memset(a->between + (size_t)thing->first * n, 0, (size_t)thing->rows * n * sizeof *a->between);
    trocar_status status = TROCAR_OK;
    for (int next = 0; next < a->node_count && status == TROCAR_OK;) {
        int count = 0, places[BATCH], nodes[BATCH];
        for (; next < a->node_count && count < BATCH; next++)
            if (own[next]) places[count] = next, nodes[count++] = a->nodes[next];
        if (count > 0) status = find_c(a, count, nodes, a->columns, why);
        for (int i = thing->first; i < thing->first + thing->rows && status == TROCAR_OK; i++)
            for (int c = 0; c < 4 && a->rows[i].tet >= 0; c++)
                for (int k = 0; k < count; k++) {
                    if (a->corner[4 * i + c] != places[k] || a->rows[i].weights[c] == 0.0) continue;
                    const double along[] = {a->rows[i].direction.x, a->rows[i].direction.y, a->rows[i].direction.z};
                    for (int b = 0; b < 3; b++)
                        cblas_daxpy((int)n, a->rows[i].weights[c] * along[b], a->columns + (3 * (size_t)k + (size_t)b) * n, 1, a->between + (size_t)i * n, 1);
                }
    }
    free(own);
    for (int i = thing->first; i < thing->first + thing->rows && status == TROCAR_OK; i++) /* copies C to the transposed entries */
        for (size_t j = 0; j < n; j++) a->between[j * n + (size_t)i] = a->between[(size_t)i * n + j];
    return status;
}

static trocar_status factor_all(attached_inverse *a, const attachment *things, trocar_error *why) {
    int n = a->row_count, q = a->motion_count, motion = 0;
    size_t ld = (size_t)n;
    memcpy(a->factor, a->between, ld * ld * sizeof *a->factor);
    for (int t = 0; t < a->placed_count; t++) {
        const attachment *thing = &things[t];
        size_t first = (size_t)a->placed[t].first;
        for (int i = 0; i < thing->row_count; i++)
            for (int j = 0; j <= i; j++) a->factor[(first + (size_t)j) * ld + first + (size_t)i] += thing->compliance[(size_t)i * (size_t)thing->ld + (size_t)j];
        for (int i = 0; i < thing->row_count && thing->mutual; i++)
            for (size_t j = 0; j < first; j++) a->factor[j * ld + first + (size_t)i] += thing->mutual[(size_t)i * (size_t)thing->mutual_ld + j];
        for (int k = 0; k < thing->motion_count; k++, motion++)
            memcpy(a->basis + (size_t)motion * ld + first, thing->motions + (size_t)k * (size_t)thing->motion_ld, (size_t)thing->row_count * sizeof *a->basis);
    }
    if (LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'L', n, a->factor, n) != 0)
        return fail(why, TROCAR_NUMERIC, "resting needles and tissue together are unstable");
    if (q == 0) return TROCAR_OK;
    cblas_dtrsm(CblasColMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, n, q, 1.0, a->factor, n, a->basis, n);
    cblas_dsyrk(CblasColMajor, CblasUpper, CblasTrans, q, n, 1.0, a->basis, n, 0.0, a->triangle, q);
    if (LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'U', q, a->triangle, q) != 0)
        return fail(why, TROCAR_NUMERIC, "nothing holds one of the resting needles");
    cblas_dtrsm(CblasColMajor, CblasRight, CblasUpper, CblasNoTrans, CblasNonUnit, n, q, 1.0, a->triangle, q, a->basis, n);
    return TROCAR_OK;
}

trocar_status inverse_attach(inverse *inv, int count, const attachment *things, trocar_error *why) {
    attached_inverse *a = (attached_inverse *)inv, before = *a;
    *a = (attached_inverse){.shared = before.shared, .base = before.base};
    trocar_status status = TROCAR_OK;
    int rows = 0;
    for (int i = 0; i < count; i++) rows += things[i].row_count;
    if (rows > 0) {
        bool room = place_all(a, count, things) && allocate_caches(a);
        status = room ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for %d resting needles", count);
        if (room) copy_between(a, &before);
        for (int t = 0; t < count && status == TROCAR_OK; t++)
            if (!find_placed(&before, things[t].id)) status = find_between(a, &a->placed[t], why);
        if (status == TROCAR_OK) status = factor_all(a, things, why);
        if (status != TROCAR_OK) detach_all(a);
    }
    detach_all(&before);
    return status;
}

/* ---- responses ---------------------------------------------------------------------------------------------------------------- */

int inverse_attached_rows(const inverse *inv) { return ((const attached_inverse *)inv)->row_count; }
int inverse_attached_motions(const inverse *inv) { return ((const attached_inverse *)inv)->motion_count; }

/* For `count` columns, replaces z with df and Q^T y with q, in place. */
static void respond(const attached_inverse *a, int count, double *force, double *motion) {
    int n = a->row_count, q = a->motion_count;
    if (count == 1) { /* reads L directly, without copying it */
        cblas_dscal(n, -1.0, force, 1);
        cblas_dtrsv(CblasColMajor, CblasLower, CblasTrans, CblasNonUnit, n, a->factor, n, force, 1);
    } else {
        cblas_dtrsm(CblasColMajor, CblasLeft, CblasLower, CblasTrans, CblasNonUnit, n, count, -1.0, a->factor, n, force, n);
    }
    if (q > 0) cblas_dtrsm(CblasColMajor, CblasLeft, CblasUpper, CblasNoTrans, CblasNonUnit, q, count, 1.0, a->triangle, q, motion, q);
}

trocar_status inverse_attached_response(inverse *inv, const nodal_forces *loads, double *force, double *motion, trocar_error *why) {
    attached_inverse *a = (attached_inverse *)inv;
    memset(force, 0, (size_t)a->row_count * sizeof *force);
    memset(motion, 0, (size_t)a->motion_count * sizeof *motion);
    if (a->row_count == 0) return TROCAR_OK;
    for (int first = 0; first < loads->count; first += TILE) {
        int count = loads->count - first < TILE ? loads->count - first : TILE;
        trocar_status status = keep_all(a, count, loads->nodes + first, why);
        if (status != TROCAR_OK) return status;
        for (int i = first; i < first + count; i++) {
            const double f[] = {loads->force[i].x, loads->force[i].y, loads->force[i].z};
            cblas_dgemv(CblasColMajor, CblasNoTrans, a->row_count, 3, 1.0, z_of(a, loads->nodes[i]), a->row_count, f, 1, 1.0, force, 1);
            if (a->motion_count > 0)
                cblas_dgemv(CblasColMajor, CblasNoTrans, a->motion_count, 3, 1.0, moved_of(a, loads->nodes[i]), a->motion_count, f, 1, 1.0, motion, 1);
        }
    }
    respond(a, 1, force, motion);
    return TROCAR_OK;
}

void inverse_attached_columns(inverse *inv, int count, const int *rows, double *force, double *motion) {
    attached_inverse *a = (attached_inverse *)inv;
    int n = a->row_count;
    memset(force, 0, (size_t)n * (size_t)count * sizeof *force);
    for (int k = 0; k < count; k++) force[(size_t)k * (size_t)n + (size_t)rows[k]] = 1.0;
    cblas_dtrsm(CblasColMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, n, count, 1.0, a->factor, n, force, n);
    project(a, count, force, motion);
    respond(a, count, force, motion);
}

void inverse_attached_displaced(inverse *inv, const double *displacement, double *force, double *motion) {
    attached_inverse *a = (attached_inverse *)inv;
    memcpy(force, displacement, (size_t)a->row_count * sizeof *force);
    if (a->row_count == 0) return;
    cblas_dtrsv(CblasColMajor, CblasLower, CblasNoTrans, CblasNonUnit, a->row_count, a->factor, a->row_count, force, 1);
    project(a, 1, force, motion);
    respond(a, 1, force, motion);
}

void inverse_attached_yield(const inverse *inv, const double *force, double *displacement) {
    const attached_inverse *a = (const attached_inverse *)inv;
    if (a->row_count == 0) return;
    memcpy(displacement, force, (size_t)a->row_count * sizeof *force);
    cblas_dtrmv(CblasColMajor, CblasLower, CblasTrans, CblasNonUnit, a->row_count, a->factor, a->row_count, displacement, 1);
    cblas_dtrmv(CblasColMajor, CblasLower, CblasNoTrans, CblasNonUnit, a->row_count, a->factor, a->row_count, displacement, 1);
}

trocar_status inverse_attached_under(inverse *inv, const nodal_forces *loads, double *displacement, trocar_error *why) {
    attached_inverse *a = (attached_inverse *)inv;
    for (int first = 0; first < loads->count && a->row_count > 0; first += TILE) {
        int count = loads->count - first < TILE ? loads->count - first : TILE;
        trocar_status status = keep_all(a, count, loads->nodes + first, why);
        if (status != TROCAR_OK) return status;
        for (int i = first; i < first + count; i++) {
            const double f[] = {loads->force[i].x, loads->force[i].y, loads->force[i].z};
            cblas_dgemv(CblasColMajor, CblasNoTrans, a->row_count, 3, 1.0, slot_of(a, loads->nodes[i]), a->row_count, f, 1, 1.0, displacement, 1);
        }
    }
    return TROCAR_OK;
}

trocar_status inverse_attached_displace(inverse *inv, const double *force, int count, const int *nodes, vec3 *displacement, trocar_error *why) {
    attached_inverse *a = (attached_inverse *)inv;
    if (a->row_count == 0) return TROCAR_OK;
    for (int first = 0; first < count; first += TILE) {
        int some = count - first < TILE ? count - first : TILE;
        trocar_status status = keep_all(a, some, nodes + first, why);
        if (status != TROCAR_OK) return status;
        for (int i = first; i < first + some; i++) {
            double u[3];
            cblas_dgemv(CblasColMajor, CblasTrans, a->row_count, 3, 1.0, slot_of(a, nodes[i]), a->row_count, force, 1, 0.0, u, 1);
            displacement[i] = v3_add(displacement[i], v3(u[0], u[1], u[2]));
        }
    }
    return TROCAR_OK;
}
