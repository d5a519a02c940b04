#include "remesh/remesh_method.h"

#include <cblas.h>
#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "base/sparse_memory.h"

/* ---- handles ----------------------------------------------------------------------------------------------------- */

double *handle_block(remesher *r, int handle, int other) {
    return r->handles + (size_t)3 * (size_t)handle * SNAPSHOT_LD + 3 * other;
}

mat3 handle_get(remesher *r, int handle, int other) {
    mat3 block = {{{0}}};
    m3_add_block(&block, 1.0, handle_block(r, handle, other), SNAPSHOT_LD);
    return block;
}

void handle_put(remesher *r, int handle, int other, const mat3 *block) {
    double *upper = handle_block(r, handle, other), *lower = handle_block(r, other, handle);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) upper[a * SNAPSHOT_LD + b] = lower[b * SNAPSHOT_LD + a] = block->m[a][b];
}

int handles_in_use(const remesher *r, int handles[MAX_HANDLES]) {
    int count = 0;
    for (int i = 0; i < r->refined.count; i++) handles[count++] = r->refined.order[i];
    for (int k = 0; k < MAX_WINDOW; k++)
        if (r->window[k] >= 0) handles[count++] = MAX_CONTACTS + k;
    return count;
}

int handle_node(const remesher *r, int handle) {
    if (handle >= MAX_CONTACTS) return r->window[handle - MAX_CONTACTS];
    return r->refined.nodes[handle].moved >= 0 ? r->refined.nodes[handle].moved : -1 - handle;
}

int window_place(const remesher *r, int node) { return r->place_of[node]; }

void window_put(remesher *r, int place, int node) {
    if (r->window[place] >= 0) r->place_of[r->window[place]] = -1;
    if (node >= 0) r->place_of[node] = place;
    r->window[place] = node;
}

int handle_of_node(const remesher *r, int node) {
    if (node < 0) return -1 - node;
    int place = window_place(r, node);
    return place < 0 ? -1 : MAX_CONTACTS + place;
}

/* ---- blocks of the nominal inverse ------------------------------------------------------------------------------- */

void gather_start(remesher *r) {
    gathered_blocks *g = &r->gathered;
    while (g->row_count > 0) g->row_of[g->rows[--g->row_count]] = -1;
    while (g->column_count > 0) g->column_of[g->columns[--g->column_count]] = -1;
    g->status = TROCAR_OK;
}

static void list_once(int node, int *place_of, int *nodes, int *count, int most) {
    if (place_of[node] >= 0 || *count == most) return; /* when full, the remaining blocks are fetched one by one */
    place_of[node] = *count;
    nodes[(*count)++] = node;
}

void gather_row(remesher *r, int node) { list_once(node, r->gathered.row_of, r->gathered.rows, &r->gathered.row_count, MAX_ROWS); }

void gather_column(remesher *r, int node) { list_once(node, r->gathered.column_of, r->gathered.columns, &r->gathered.column_count, MAX_COLUMNS); }

trocar_status gather_finish(remesher *r, trocar_error *why) {
    gathered_blocks *g = &r->gathered;
    return inverse_gather(r->inverse, &(inverse_blocks){g->row_count, g->rows, g->column_count, g->columns, g->blocks, 3 * MAX_COLUMNS}, why);
}

mat3 nominal_block(remesher *r, int node, int other) {
    gathered_blocks *g = &r->gathered;
    mat3 block = {{{0}}};
    bool straight = g->row_of[node] >= 0 && g->column_of[other] >= 0;
    if (straight || (g->row_of[other] >= 0 && g->column_of[node] >= 0)) {
        int row = g->row_of[straight ? node : other], column = g->column_of[straight ? other : node];
        m3_add_block(&block, 1.0, g->blocks + (size_t)(3 * row) * 3 * MAX_COLUMNS + 3 * column, 3 * MAX_COLUMNS);
        return straight ? block : m3_transposed(&block);
    }
    trocar_status status = inverse_gather(r->inverse, &(inverse_blocks){1, &node, 1, &other, &block.m[0][0], 3}, &g->why);
    if (status != TROCAR_OK) g->status = status;
    return block;
}

/* ---- low-rank changes -------------------------------------------------------------------------------------------- */

trocar_status change_middle(int n, strided_matrix change, strided_matrix block, double *middle, trocar_error *why) {
    double system[MAX_RANK * MAX_RANK];
    lapack_int pivots[MAX_RANK];
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, n, n, n, 1.0, change.entries, change.ld, block.entries, block.ld, 0.0, system, n);
    for (int a = 0; a < n; a++) {
        system[a * n + a] += 1.0;
        memmove(middle + a * n, change.entries + a * change.ld, (size_t)n * sizeof *middle);
    }
    if (LAPACKE_dgesv(LAPACK_ROW_MAJOR, n, n, system, n, pivots, middle, n) != 0)
        return fail(why, TROCAR_NUMERIC, "the change of stiffness at a contact node is singular");
    for (int a = 0; a < n; a++)
        for (int b = 0; b < a; b++) middle[a * n + b] = middle[b * n + a] = 0.5 * (middle[a * n + b] + middle[b * n + a]);
    return TROCAR_OK;
}

/* ---- creation ------------------------------------------------------------------------------------------------------ */

static const size_t BLOCKS_BYTES = (size_t)9 * MAX_ROWS * MAX_COLUMNS * sizeof(double), HANDLES_BYTES = (size_t)SNAPSHOT_LD * SNAPSHOT_LD * sizeof(double);

static bool gathered_create(gathered_blocks *g, int nodes) {
    g->row_of = malloc((size_t)nodes * sizeof *g->row_of);
    g->column_of = malloc((size_t)nodes * sizeof *g->column_of);
    g->blocks = sparse_zeros(BLOCKS_BYTES);
    for (int i = 0; g->row_of && g->column_of && i < nodes; i++) g->row_of[i] = g->column_of[i] = -1;
    return g->row_of && g->column_of && g->blocks;
}

static void gathered_free(gathered_blocks *g) {
    free(g->row_of);
    free(g->column_of);
    sparse_free(g->blocks, BLOCKS_BYTES);
}

trocar_status remesher_init(remesher *r, const remesh_operations *operations, inverse *inv, trocar_error *why) {
    r->operations = operations;
    r->inverse = inv;
    r->tissue = inverse_tissue(inv);
    for (int k = 0; k < MAX_WINDOW; k++) r->window[k] = -1;
    r->handles = sparse_zeros(HANDLES_BYTES);
    r->place_of = malloc((size_t)r->tissue->mesh->node_count * sizeof *r->place_of);
    for (int i = 0; r->place_of && i < r->tissue->mesh->node_count; i++) r->place_of[i] = -1;
    trocar_status status = resolver_create(r->tissue, &r->resolver, why);
    if (status != TROCAR_OK) return status;
    bool gathers = gathered_create(&r->gathered, r->tissue->mesh->node_count);
    return r->handles && r->place_of && gathers ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory");
}

void remesher_release(remesher *r) {
    gathered_free(&r->gathered);
    resolver_free(r->resolver);
    free(r->place_of);
    sparse_free(r->handles, HANDLES_BYTES);
}
