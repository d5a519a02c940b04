#include "inverse_owner.h"

#include <stdlib.h>
#include <string.h>

/* Workspace of cholmod_solve2, kept between solves: no allocation after the first. One to a thread. */
typedef struct {
    cholmod_common common;
    cholmod_dense *right, *solution, *y, *e;
} solver;

/* Columns of K^-1 on demand: a CHOLMOD factor and a cache of the columns asked for, the least recently used go first. */
typedef struct {
    inverse shared;
    int slot_count;          /* nodes whose columns fit into the cache */
    int *slot;               /* node_count: where a node's columns are, or -1 */
    int *node;               /* slot_count: whose columns they are, or -1 */
    uint64_t *used;          /* slot_count: time of last use */
    uint64_t time;
    double *columns;         /* slot_count x 3 x dof_count, m/N */
    solver columns_solver;   /* of the thread that gathers */
    solver field_solver;     /* of the thread that asks for whole fields: it may be another one */
} sparse_inverse;

enum { BLOCK_NODES = 8 };    /* solved at once: 24 right-hand sides */
static const double CACHE_BYTES = 1.5e9;

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
    return s->columns + (size_t)slot * 3 * (size_t)s->shared.tissue->dof_count;
}

static bool solver_create(solver *w, size_t n, size_t columns) {
    cholmod_start(&w->common);
    w->common.print = 0;
    w->right = cholmod_zeros(n, columns, CHOLMOD_REAL, &w->common);
    return w->right != NULL;
}

static void solver_free(solver *w) {
    cholmod_free_dense(&w->right, &w->common);
    cholmod_free_dense(&w->solution, &w->common);
    cholmod_free_dense(&w->y, &w->common);
    cholmod_free_dense(&w->e, &w->common);
    cholmod_finish(&w->common);
}

/* K x = right for its first columns; the solution stays in the workspace. */
static const double *solver_run(solver *w, const tissue *t, size_t columns) {
    size_t all = w->right->ncol;
    w->right->ncol = columns;
    cholmod_solve2(CHOLMOD_A, t->factor, w->right, NULL, &w->solution, NULL, &w->y, &w->e, &w->common);
    w->right->ncol = all;
    return w->solution->x;
}

/* Solves for the columns of up to BLOCK_NODES nodes. */
static void solve_columns(sparse_inverse *s, int count, const int *nodes) {
    const tissue *t = s->shared.tissue;
    size_t n = (size_t)t->dof_count, width = (size_t)(3 * count);
    double *right = s->columns_solver.right->x;
    memset(right, 0, n * width * sizeof *right);
    for (int i = 0; i < count; i++)
        for (int a = 0; a < 3; a++) right[(size_t)(3 * i + a) * n + (size_t)(t->dof[nodes[i]] + a)] = 1.0;
    const double *solution = solver_run(&s->columns_solver, t, width);
    for (int i = 0; i < count; i++) memcpy(claim(s, nodes[i]), solution + (size_t)(3 * i) * n, 3 * n * sizeof(double));
}

static void sparse_prefetch(inverse *inv, int count, const int *nodes) {
    sparse_inverse *s = (sparse_inverse *)inv;
    int missing[BLOCK_NODES], found = 0;
    for (int i = 0; i < count; i++) {
        if (inv->tissue->dof[nodes[i]] < 0) continue;
        if (s->slot[nodes[i]] >= 0) s->used[s->slot[nodes[i]]] = ++s->time;
        else missing[found++] = nodes[i];
        if (found == BLOCK_NODES) solve_columns(s, found, missing), found = 0;
    }
    if (found > 0) solve_columns(s, found, missing);
}

static const double *columns_of(sparse_inverse *s, int node) {
    if (s->slot[node] < 0) solve_columns(s, 1, &node);
    s->used[s->slot[node]] = ++s->time;
    return s->columns + (size_t)s->slot[node] * 3 * (size_t)s->shared.tissue->dof_count;
}

/* A block is read from whichever of the two nodes has its columns at hand: K^-1 is symmetric. */
static void sparse_block(sparse_inverse *s, int row, int column, double *out, int ld) {
    const int *dof = s->shared.tissue->dof;
    size_t n = (size_t)s->shared.tissue->dof_count;
    bool fixed = dof[row] < 0 || dof[column] < 0, swap = !fixed && s->slot[column] < 0 && s->slot[row] >= 0;
    const double *columns = fixed ? NULL : columns_of(s, swap ? row : column);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++)
            out[a * ld + b] = fixed ? 0.0 : swap ? columns[(size_t)a * n + (size_t)(dof[column] + b)] : columns[(size_t)b * n + (size_t)(dof[row] + a)];
}

static void sparse_gather(inverse *inv, int row_count, const int *rows, int column_count, const int *columns, double *out, int ld) {
    for (int i = 0; i < row_count; i++)
        for (int j = 0; j < column_count; j++) sparse_block((sparse_inverse *)inv, rows[i], columns[j], out + 3 * i * ld + 3 * j, ld);
}

static void sparse_apply(inverse *inv, const double *force, double *displacement) {
    sparse_inverse *s = (sparse_inverse *)inv;
    size_t bytes = (size_t)inv->tissue->dof_count * sizeof *force;
    memcpy(s->field_solver.right->x, force, bytes);
    memcpy(displacement, solver_run(&s->field_solver, inv->tissue, 1), bytes);
}

static void sparse_release(inverse *inv) {
    sparse_inverse *s = (sparse_inverse *)inv;
    solver_free(&s->columns_solver);
    solver_free(&s->field_solver);
    free(s->slot);
    free(s->node);
    free(s->used);
    free(s->columns);
}

static const inverse_owner sparse_owner = {"sparse", sparse_gather, sparse_apply, sparse_prefetch, sparse_release};

trocar_status inverse_create_sparse(tissue *t, inverse **created, report *why) {
    size_t n = (size_t)t->dof_count, nodes = (size_t)t->mesh->node_count, slots = (size_t)(CACHE_BYTES / (24.0 * (double)n));
    if (slots > nodes) slots = nodes;
    if (slots < 64) slots = 64;
    sparse_inverse *s = calloc(1, sizeof *s);
    *created = s ? &s->shared : NULL;
    if (!s) return fail(why, TROCAR_NO_MEMORY, "no memory");
    s->slot_count = (int)slots;
    s->slot = malloc(nodes * sizeof *s->slot);
    s->node = malloc(slots * sizeof *s->node);
    s->used = calloc(slots, sizeof *s->used);
    s->columns = malloc(slots * 3 * n * sizeof *s->columns);
    bool ready = inverse_init(&s->shared, &sparse_owner, t, why) == TROCAR_OK;
    ready = solver_create(&s->columns_solver, n, 3 * BLOCK_NODES) && ready;
    ready = solver_create(&s->field_solver, n, 1) && ready;
    if (!ready || !s->slot || !s->node || !s->used || !s->columns) {
        inverse_free(&s->shared);
        *created = NULL;
        return fail(why, TROCAR_NO_MEMORY, "no memory for the columns of the inverse (%.1f GB)", 24e-9 * (double)(slots * n));
    }
    for (size_t i = 0; i < nodes; i++) s->slot[i] = -1;
    for (size_t i = 0; i < slots; i++) s->node[i] = -1;
    return TROCAR_OK;
}
