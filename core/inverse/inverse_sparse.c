#include "inverse/inverse_owner.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "inverse/block_cache.h"
#include "inverse/sparse_inverse_columns.h"

/* Workspace of cholmod_solve2, kept between solves: no allocation after the first. One to a thread. */
typedef struct {
    cholmod_common common;
    cholmod_dense *right, *solution, *y, *e;
} solver;

/* Half-solves of nodes on demand; they and the blocks made of them are kept, the least recently used go first. */
typedef struct {
    inverse shared;
    sparse_columns *half;
    int slot_count;          /* half-solves that fit into the cache */
    size_t slot_size;        /* numbers in the longest one */
    int *slot;               /* node_count: where a node's half-solve is, or -1 */
    int *node;               /* slot_count: whose it is, or -1 */
    uint64_t *used;          /* slot_count: time of last use */
    uint64_t time;
    double *halves;          /* slot_count x slot_size */
    mtx_t gather_lock;       /* of all above */
    double *block, *tile;    /* 3 PRODUCT_BLOCK square: scratch of gather */
    block_cache blocks;
    solver field_solver;     /* of the thread that asks for whole fields: it may be another one */
} sparse_inverse;

enum { LEAST_SLOTS = 2 * PRODUCT_BLOCK }; /* what one product needs at once */

static int oldest_slot(const sparse_inverse *s) {
    int oldest = 0;
    for (int i = 1; i < s->slot_count; i++)
        if (s->used[i] < s->used[oldest]) oldest = i;
    return oldest;
}

/* Gives the node a slot of the cache, taking it from the one not used for longest. */
static double *claim(sparse_inverse *s, int node) {
    int slot = oldest_slot(s);
    if (s->node[slot] >= 0) s->slot[s->node[slot]] = -1;
    s->node[slot] = node;
    s->slot[node] = slot;
    s->used[slot] = ++s->time;
    return s->halves + (size_t)slot * s->slot_size;
}

/* Solves for up to HALF_BLOCK nodes that are not in the cache. */
static void solve_halves(sparse_inverse *s, int count, const int *nodes) {
    int dofs[HALF_BLOCK];
    double *y[HALF_BLOCK];
    for (int i = 0; i < count; i++) {
        dofs[i] = s->shared.tissue->dof[nodes[i]];
        y[i] = claim(s, nodes[i]);
    }
    sparse_columns_half_solve(s->half, count, dofs, y);
}

/* Of nodes that can move. Those that are there are kept from being the oldest before any other goes: LEAST_SLOTS nodes at once
   stay together. */
static void solve_missing(sparse_inverse *s, int count, const int *nodes) {
    int missing[HALF_BLOCK], found = 0;
    for (int i = 0; i < count; i++)
        if (s->slot[nodes[i]] >= 0) s->used[s->slot[nodes[i]]] = ++s->time;
    for (int i = 0; i < count; i++) {
        bool asked = s->slot[nodes[i]] >= 0;
        for (int k = 0; k < found; k++) asked |= missing[k] == nodes[i];
        if (!asked) missing[found++] = nodes[i];
        if (found == HALF_BLOCK) solve_halves(s, found, missing), found = 0;
    }
    if (found > 0) solve_halves(s, found, missing);
}

/* One side of a block: the nodes that can move. */
typedef struct {
    int count, node[PRODUCT_BLOCK], dof[PRODUCT_BLOCK], place[PRODUCT_BLOCK];
    const double *y[PRODUCT_BLOCK];
} block_side;

static block_side movable(const tissue *t, int count, const int *nodes) {
    block_side side = {0};
    for (int i = 0; i < count; i++) {
        if (t->dof[nodes[i]] < 0) continue;
        side.node[side.count] = nodes[i];
        side.dof[side.count] = t->dof[nodes[i]];
        side.place[side.count++] = i;
    }
    return side;
}

static void point_to_halves(sparse_inverse *s, block_side *side) {
    for (int i = 0; i < side->count; i++) side->y[i] = s->halves + (size_t)s->slot[side->node[i]] * s->slot_size;
}

/* At most PRODUCT_BLOCK rows and columns. */
static void gather_block(sparse_inverse *s, int row_count, const int *rows, int column_count, const int *columns, double *out, int ld) {
    block_side left = movable(s->shared.tissue, row_count, rows), right = movable(s->shared.tissue, column_count, columns);
    int both[LEAST_SLOTS];
    memcpy(both, left.node, (size_t)left.count * sizeof *both);
    memcpy(both + left.count, right.node, (size_t)right.count * sizeof *both);
    solve_missing(s, left.count + right.count, both);
    point_to_halves(s, &left);
    point_to_halves(s, &right);
    sparse_columns_product(s->half, left.count, left.dof, left.y, right.count, right.dof, right.y, s->block, 3 * PRODUCT_BLOCK);
    for (int i = 0; i < 3 * row_count; i++) memset(out + (size_t)i * (size_t)ld, 0, 3 * (size_t)column_count * sizeof *out);
    for (int i = 0; i < left.count; i++)
        for (int j = 0; j < right.count; j++)
            for (int a = 0; a < 3; a++)
                memcpy(out + (size_t)(3 * left.place[i] + a) * (size_t)ld + 3 * right.place[j],
                       s->block + (3 * i + a) * 3 * PRODUCT_BLOCK + 3 * j, 3 * sizeof *out);
}

static int least(int a, int b) { return a < b ? a : b; }

/* Without the blocks that are kept. */
static void gather_afresh(sparse_inverse *s, int row_count, const int *rows, int column_count, const int *columns, double *out, int ld) {
    for (int i = 0; i < row_count; i += PRODUCT_BLOCK)
        for (int j = 0; j < column_count; j += PRODUCT_BLOCK)
            gather_block(s, least(row_count - i, PRODUCT_BLOCK), rows + i, least(column_count - j, PRODUCT_BLOCK), columns + j,
                         out + (size_t)(3 * i) * (size_t)ld + 3 * j, ld);
}

/* Lists those of `nodes` that some block with `others` is missing for. */
static int list_missing(const block_cache *c, int count, const int *nodes, int other_count, const int *others, int *missing) {
    int found = 0;
    for (int i = 0; i < count; i++) {
        bool all = true;
        for (int j = 0; j < other_count && all; j++) all = block_cache_knows(c, nodes[i], others[j]);
        if (!all) missing[found++] = nodes[i];
    }
    return found;
}

static void compute_missing(sparse_inverse *s, int row_count, const int *rows, int column_count, const int *columns) {
    int missing_rows[BLOCK_CACHE_NODES], missing_columns[BLOCK_CACHE_NODES];
    int row_end = list_missing(&s->blocks, row_count, rows, column_count, columns, missing_rows);
    int column_end = list_missing(&s->blocks, column_count, columns, row_end, missing_rows, missing_columns);
    for (int i = 0; i < row_end; i += PRODUCT_BLOCK)
        for (int j = 0; j < column_end; j += PRODUCT_BLOCK) {
            int high = least(row_end - i, PRODUCT_BLOCK), wide = least(column_end - j, PRODUCT_BLOCK);
            gather_block(s, high, missing_rows + i, wide, missing_columns + j, s->tile, 3 * PRODUCT_BLOCK);
            for (int k = 0; k < high * wide; k++)
                block_cache_put(&s->blocks, missing_rows[i + k / wide], missing_columns[j + k % wide],
                                s->tile + 3 * (k / wide) * 3 * PRODUCT_BLOCK + 3 * (k % wide), 3 * PRODUCT_BLOCK);
        }
}

static void gather_cached(sparse_inverse *s, int row_count, const int *rows, int column_count, const int *columns, double *out, int ld) {
    if (!block_cache_take(&s->blocks, row_count, rows, column_count, columns)) {
        gather_afresh(s, row_count, rows, column_count, columns, out, ld);
        return;
    }
    compute_missing(s, row_count, rows, column_count, columns);
    for (int i = 0; i < row_count; i++)
        for (int j = 0; j < column_count; j++) block_cache_get(&s->blocks, rows[i], columns[j], out + (size_t)(3 * i) * (size_t)ld + 3 * j, ld);
}

static trocar_status sparse_gather(inverse *inv, int row_count, const int *rows, int column_count, const int *columns, double *out, int ld,
                                   report *why) {
    (void)why;
    sparse_inverse *s = (sparse_inverse *)inv;
    mtx_lock(&s->gather_lock);
    gather_cached(s, row_count, rows, column_count, columns, out, ld);
    mtx_unlock(&s->gather_lock);
    return TROCAR_OK;
}

/* K x = right; the solution stays in the workspace. NULL without memory, which only the first call takes. */
static const double *solver_run(solver *w, const tissue *t) {
    bool solved = cholmod_solve2(CHOLMOD_A, t->factor, w->right, NULL, &w->solution, NULL, &w->y, &w->e, &w->common);
    return solved ? w->solution->x : NULL;
}

/* Solves once, so that a lack of memory shows here and not later. */
static bool solver_create(solver *w, const tissue *t) {
    cholmod_start(&w->common);
    w->common.print = 0;
    w->right = cholmod_zeros((size_t)t->dof_count, 1, CHOLMOD_REAL, &w->common);
    return w->right != NULL && solver_run(w, t) != NULL;
}

static void solver_free(solver *w) {
    cholmod_free_dense(&w->right, &w->common);
    cholmod_free_dense(&w->solution, &w->common);
    cholmod_free_dense(&w->y, &w->common);
    cholmod_free_dense(&w->e, &w->common);
    cholmod_finish(&w->common);
}

static void sparse_apply(inverse *inv, const double *force, double *displacement) {
    sparse_inverse *s = (sparse_inverse *)inv;
    size_t bytes = (size_t)inv->tissue->dof_count * sizeof *force;
    memcpy(s->field_solver.right->x, force, bytes);
    const double *solution = solver_run(&s->field_solver, inv->tissue);
    if (solution != NULL) memcpy(displacement, solution, bytes);
    else memset(displacement, 0, bytes);
}

static void sparse_release(inverse *inv) {
    sparse_inverse *s = (sparse_inverse *)inv;
    mtx_destroy(&s->gather_lock);
    solver_free(&s->field_solver);
    sparse_columns_free(s->half);
    free(s->slot);
    free(s->node);
    free(s->used);
    free(s->halves);
    free(s->block);
    free(s->tile);
    block_cache_free(&s->blocks);
}

static const inverse_owner sparse_owner = {"sparse", sparse_gather, sparse_apply, NULL, sparse_release, true, NULL};

static bool create_cache(sparse_inverse *s, double bytes) {
    size_t nodes = (size_t)s->shared.tissue->mesh->node_count, slots;
    s->slot_size = 3 * (size_t)sparse_columns_longest(s->half);
    slots = (size_t)fmin(fmax(bytes / (8.0 * (double)s->slot_size), LEAST_SLOTS), fmax((double)nodes, LEAST_SLOTS));
    s->slot_count = (int)slots;
    s->slot = malloc(nodes * sizeof *s->slot);
    s->node = malloc(slots * sizeof *s->node);
    s->used = calloc(slots, sizeof *s->used);
    s->halves = malloc(slots * s->slot_size * sizeof *s->halves);
    s->block = malloc(sizeof(double[9 * PRODUCT_BLOCK * PRODUCT_BLOCK]));
    s->tile = malloc(sizeof(double[9 * PRODUCT_BLOCK * PRODUCT_BLOCK]));
    if (!s->slot || !s->node || !s->used || !s->halves || !s->block || !s->tile || !block_cache_create(&s->blocks, (int)nodes)) return false;
    for (size_t i = 0; i < nodes; i++) s->slot[i] = -1;
    for (size_t i = 0; i < slots; i++) s->node[i] = -1;
    return true;
}

trocar_status inverse_create_sparse(tissue *t, double cache_bytes, inverse **created, report *why) {
    sparse_inverse *s = calloc(1, sizeof *s);
    *created = s ? &s->shared : NULL;
    if (!s) return fail(why, TROCAR_NO_MEMORY, "no memory");
    trocar_status status = inverse_init(&s->shared, &sparse_owner, t, why);
    mtx_init(&s->gather_lock, mtx_plain);
    bool solver_ready = solver_create(&s->field_solver, t);
    if (status == TROCAR_OK) status = sparse_columns_create(t, &s->half, why);
    if (status == TROCAR_OK && !(solver_ready && create_cache(s, cache_bytes)))
        status = fail(why, TROCAR_NO_MEMORY, "no memory for the rows of the inverse (%.1f GB)", 1e-9 * cache_bytes);
    if (status == TROCAR_OK) return TROCAR_OK;
    inverse_free(&s->shared);
    *created = NULL;
    return status;
}
