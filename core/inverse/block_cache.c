#include "inverse/block_cache.h"

#include <stddef.h>
#include <stdlib.h>

enum { ALL = BLOCK_CACHE_NODES };

bool block_cache_create(block_cache *c, int node_count) {
    c->place = malloc((size_t)node_count * sizeof *c->place);
    c->known = calloc((size_t)ALL * ALL, sizeof *c->known);
    c->blocks = calloc((size_t)9 * ALL * ALL, sizeof *c->blocks); /* pages not needed stay untouched */
    for (int i = 0; i < node_count && c->place; i++) c->place[i] = -1;
    for (int i = 0; i < ALL; i++) c->node[i] = -1;
    return c->place && c->known && c->blocks;
}

void block_cache_free(block_cache *c) {
    free(c->place);
    free(c->known);
    free(c->blocks);
}

static int oldest_place(const block_cache *c) {
    int oldest = 0;
    for (int i = 1; i < ALL; i++)
        if (c->used[i] < c->used[oldest]) oldest = i;
    return oldest;
}

static void claim(block_cache *c, int node) {
    int place = c->place[node] >= 0 ? c->place[node] : oldest_place(c);
    c->used[place] = ++c->time;
    if (c->node[place] == node) return;
    if (c->node[place] >= 0) c->place[c->node[place]] = -1;
    for (size_t i = 0; i < ALL; i++) c->known[(size_t)place * ALL + i] = c->known[i * ALL + (size_t)place] = false;
    c->node[place] = node;
    c->place[node] = place;
}

/* Those that are there first, so that they are not the oldest when the others come. */
static void claim_all(block_cache *c, int count, const int *nodes, bool there) {
    for (int i = 0; i < count; i++)
        if ((c->place[nodes[i]] >= 0) == there) claim(c, nodes[i]);
}

bool block_cache_take(block_cache *c, int row_count, const int *rows, int column_count, const int *columns) {
    if (row_count + column_count > ALL) return false;
    claim_all(c, row_count, rows, true);
    claim_all(c, column_count, columns, true);
    claim_all(c, row_count, rows, false);
    claim_all(c, column_count, columns, false);
    return true;
}

/* Index of the block, with `transposed` where it is kept the other way round. */
static size_t find(const block_cache *c, int row, int column, bool *transposed) {
    size_t i = (size_t)c->place[row], j = (size_t)c->place[column];
    *transposed = i > j;
    return i > j ? j * ALL + i : i * ALL + j;
}

bool block_cache_knows(const block_cache *c, int row, int column) { return c->known[(size_t)c->place[row] * ALL + (size_t)c->place[column]]; }

void block_cache_put(block_cache *c, int row, int column, const double *block, int ld) {
    bool transposed;
    double *kept = c->blocks + 9 * find(c, row, column, &transposed);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) kept[transposed ? 3 * b + a : 3 * a + b] = block[a * ld + b];
    c->known[(size_t)c->place[row] * ALL + (size_t)c->place[column]] = c->known[(size_t)c->place[column] * ALL + (size_t)c->place[row]] = true;
}

void block_cache_get(const block_cache *c, int row, int column, double *block, int ld) {
    bool transposed;
    const double *kept = c->blocks + 9 * find(c, row, column, &transposed);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) block[a * ld + b] = kept[transposed ? 3 * b + a : 3 * a + b];
}
