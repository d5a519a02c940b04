#include "inverse/block_cache.h"

#include <stddef.h>
#include <stdlib.h>

enum { ALL = BLOCK_CACHE_NODES };

bool block_cache_create(block_cache *c, int node_count) {
    c->known = calloc((size_t)ALL * ALL, sizeof *c->known);
    c->blocks = calloc((size_t)9 * ALL * ALL, sizeof *c->blocks); /* pages not needed stay untouched */
    return lru_create(&c->nodes, (size_t)node_count, ALL) && c->known && c->blocks;
}

void block_cache_free(block_cache *c) {
    lru_free(&c->nodes);
    free(c->known);
    free(c->blocks);
}

static void claim(block_cache *c, int node) {
    if (lru_touch(&c->nodes, node)) return;
    size_t place = (size_t)lru_claim(&c->nodes, node);
    for (size_t i = 0; i < ALL; i++) c->known[place * ALL + i] = c->known[i * ALL + place] = false;
}

static size_t place(const block_cache *c, int node) { return (size_t)c->nodes.slot[node]; }

/* Those that are there first, so that they are not the oldest when the others come. */
static void claim_all(block_cache *c, int count, const int *nodes, bool there) {
    for (int i = 0; i < count; i++)
        if ((c->nodes.slot[nodes[i]] >= 0) == there) claim(c, nodes[i]);
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
    size_t i = place(c, row), j = place(c, column);
    *transposed = i > j;
    return i > j ? j * ALL + i : i * ALL + j;
}

bool block_cache_knows(const block_cache *c, int row, int column) { return c->known[place(c, row) * ALL + place(c, column)]; }

void block_cache_put(block_cache *c, int row, int column, const double *block, int ld) {
    bool transposed;
    double *kept = c->blocks + 9 * find(c, row, column, &transposed);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) kept[transposed ? 3 * b + a : 3 * a + b] = block[a * ld + b];
    c->known[place(c, row) * ALL + place(c, column)] = c->known[place(c, column) * ALL + place(c, row)] = true;
}

void block_cache_get(const block_cache *c, int row, int column, double *block, int ld) {
    bool transposed;
    const double *kept = c->blocks + 9 * find(c, row, column, &transposed);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) block[a * ld + b] = kept[transposed ? 3 * b + a : 3 * a + b];
}
