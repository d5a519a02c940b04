#include "inverse/inverse.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "inverse/inverse_owner.h"
#include "inverse/block_cache.h"
#include "inverse/sparse_inverse_columns.h"
#include "tissue/factor_solve.h"

/* A solver with its own workspace; each thread needs one. */
typedef struct {
    cholmod_common common;
    cholmod_dense *right;
    factor_solution solution;
} solver;

/* The sparse inverse. Half-solves are computed on demand; LRU caches keep them and the resulting blocks. */
typedef struct {
    inverse shared;
    sparse_columns *half;
    lru slots;               /* cache slots of the nodes' half-solves */
    size_t slot_size;        /* number of entries in a slot: those of the longest half-solve */
    double *halves;          /* slots.slot_count x slot_size */
    pthread_mutex_t gather_lock;       /* protects all members except `shared` and `field_solver` */
    double *block, *tile;    /* scratch for gathering: 3 PRODUCT_BLOCK x 3 PRODUCT_BLOCK matrices */
    block_cache blocks;
    solver field_solver;     /* solver for displacement fields, which may be requested in another thread */
} sparse_inverse;

enum { LEAST_SLOTS = 2 * PRODUCT_BLOCK }; /* number of slots needed for one product */

/* Solves for up to HALF_BLOCK nodes that are not in the cache. */
static void solve_halves(sparse_inverse *s, int count, const int *nodes) {
    int dofs[HALF_BLOCK];
    double *y[HALF_BLOCK];
    for (int i = 0; i < count; i++) {
        dofs[i] = s->shared.tissue->dof[nodes[i]];
        y[i] = s->halves + (size_t)lru_claim(&s->slots, nodes[i]) * s->slot_size;
    }
    sparse_columns_half_solve(s->half, count, dofs, y);
}

/* Computes the half-solves of these free nodes that are not cached yet. Marks the cached ones as used first, so that they are not evicted; with up to
   LEAST_SLOTS nodes, all are then cached. */
static void solve_missing(sparse_inverse *s, int count, const int *nodes) {
    int missing[HALF_BLOCK], found = 0;
    for (int i = 0; i < count; i++) lru_touch(&s->slots, nodes[i]);
    for (int i = 0; i < count; i++) {
        bool asked = s->slots.slot[nodes[i]] >= 0;
        for (int k = 0; k < found; k++) asked |= missing[k] == nodes[i];
        if (!asked) missing[found++] = nodes[i];
        if (found == HALF_BLOCK) solve_halves(s, found, missing), found = 0;
    }
    if (found > 0) solve_halves(s, found, missing);
}

/* The rows or columns of a product: those of the given nodes that are free. */
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
    for (int i = 0; i < side->count; i++) side->y[i] = s->halves + (size_t)s->slots.slot[side->node[i]] * s->slot_size;
}

/* Writes the blocks between at most PRODUCT_BLOCK rows and PRODUCT_BLOCK columns. */
static void gather_block(sparse_inverse *s, const inverse_blocks *b) {
    block_side left = movable(s->shared.tissue, b->row_count, b->rows), right = movable(s->shared.tissue, b->column_count, b->columns);
    int both[LEAST_SLOTS];
    memcpy(both, left.node, (size_t)left.count * sizeof *both);
    memcpy(both + left.count, right.node, (size_t)right.count * sizeof *both);
    solve_missing(s, left.count + right.count, both);
    point_to_halves(s, &left);
    point_to_halves(s, &right);
    sparse_columns_product(s->half, &(half_solved){left.count, left.dof, left.y}, &(half_solved){right.count, right.dof, right.y}, s->block, 3 * PRODUCT_BLOCK);
    for (int i = 0; i < 3 * b->row_count; i++) memset(b->out + (size_t)i * (size_t)b->ld, 0, 3 * (size_t)b->column_count * sizeof *b->out);
    for (int i = 0; i < left.count; i++)
        for (int j = 0; j < right.count; j++)
            for (int a = 0; a < 3; a++)
                memcpy(b->out + (size_t)(3 * left.place[i] + a) * (size_t)b->ld + 3 * right.place[j],
                       s->block + (3 * i + a) * 3 * PRODUCT_BLOCK + 3 * j, 3 * sizeof *b->out);
}

static trocar_status compute_tile(void *context, const inverse_blocks *tile, trocar_error *why) {
    (void)why;
    gather_block(context, tile);
    return TROCAR_OK;
}

static trocar_status sparse_gather(inverse *inv, const inverse_blocks *blocks, trocar_error *why) {
    sparse_inverse *s = (sparse_inverse *)inv;
    pthread_mutex_lock(&s->gather_lock);
    trocar_status status = block_cache_gather(&s->blocks, &(block_source){compute_tile, s, s->tile, PRODUCT_BLOCK}, blocks, why);
    pthread_mutex_unlock(&s->gather_lock);
    return status;
}

/* Solves K x = right. Returns the solution, which belongs to the solver; NULL if out of memory. Only the first call allocates. */
static const double *solver_run(solver *w, const tissue *t) {
    return factor_solve(t->factor, w->right, &w->solution, &w->common) ? w->solution.x->x : NULL;
}

/* Solves once, because the first solve allocates memory. */
static bool solver_create(solver *w, const tissue *t) {
    cholmod_start(&w->common);
    w->common.print = 0;
    w->right = cholmod_zeros((size_t)t->dof_count, 1, CHOLMOD_REAL, &w->common);
    return w->right != NULL && solver_run(w, t) != NULL;
}

static void solver_free(solver *w) {
    cholmod_free_dense(&w->right, &w->common);
    factor_solution_free(&w->solution, &w->common);
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
    pthread_mutex_destroy(&s->gather_lock);
    solver_free(&s->field_solver);
    sparse_columns_free(s->half);
    lru_free(&s->slots);
    free(s->halves);
    free(s->block);
    free(s->tile);
    block_cache_free(&s->blocks);
}

static bool sparse_prefetches(const inverse *inv) {
    (void)inv;
    return true;
}

static const inverse_owner sparse_owner = {"sparse", sparse_gather, sparse_apply, NULL, sparse_release, sparse_prefetches, NULL, NULL};

static bool create_cache(sparse_inverse *s, double bytes) {
    size_t nodes = (size_t)s->shared.tissue->mesh->node_count, slots;
    s->slot_size = 3 * (size_t)sparse_columns_longest(s->half);
    slots = (size_t)fmin(fmax(bytes / (8.0 * (double)s->slot_size), LEAST_SLOTS), fmax((double)nodes, LEAST_SLOTS));
    s->halves = malloc(slots * s->slot_size * sizeof *s->halves);
    s->block = malloc(sizeof(double[9 * PRODUCT_BLOCK * PRODUCT_BLOCK]));
    s->tile = malloc(sizeof(double[9 * PRODUCT_BLOCK * PRODUCT_BLOCK]));
    return lru_create(&s->slots, nodes, slots) && s->halves && s->block && s->tile && block_cache_create(&s->blocks, (int)nodes);
}

trocar_status inverse_create_sparse(tissue *t, double cache_bytes, inverse **created, trocar_error *why) {
    sparse_inverse *s = calloc(1, sizeof *s);
    *created = s ? &s->shared : NULL;
    if (!s) return fail(why, TROCAR_NO_MEMORY, "no memory");
    trocar_status status = inverse_init(&s->shared, &sparse_owner, t, why);
    pthread_mutex_init(&s->gather_lock, NULL);
    bool solver_ready = solver_create(&s->field_solver, t);
    if (status == TROCAR_OK) status = sparse_columns_create(t, &s->half, why);
    if (status == TROCAR_OK && !(solver_ready && create_cache(s, cache_bytes)))
        status = fail(why, TROCAR_NO_MEMORY, "no memory for the rows of the inverse (%.1f GB)", 1e-9 * cache_bytes);
    if (status == TROCAR_OK) return TROCAR_OK;
    inverse_free(&s->shared);
    *created = NULL;
    return status;
}
