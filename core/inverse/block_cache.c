#include "inverse/block_cache.h"

#include <stddef.h>
#include <stdlib.h>

enum { ALL = BLOCK_CACHE_NODES };

bool block_cache_create(block_cache *c, int node_count) {
    c->known = calloc((size_t)ALL * ALL, sizeof *c->known);
    c->blocks = calloc((size_t)9 * ALL * ALL, sizeof *c->blocks); /* calloc does not touch an array this large, so unused pages take up no memory */
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

/* Assigns slots to those of the nodes that are (`there` true) or are not (`there` false) in the cache already. Do this for the cached nodes first, so that
   adding the others does not evict them. */
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

/* Returns the index of the block; sets `transposed` if the block is stored transposed. */
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

/* ---- gathering -------------------------------------------------------------------------------------------------------------- */

static int least(int a, int b) { return a < b ? a : b; }

/* Computes the blocks without using the cache. */
static trocar_status gather_afresh(const block_source *s, const inverse_blocks *b, trocar_error *why) {
    trocar_status status = TROCAR_OK;
    for (int i = 0; i < b->row_count; i += s->size)
        for (int j = 0; j < b->column_count && status == TROCAR_OK; j += s->size)
            status = s->compute(s->context, &(inverse_blocks){least(b->row_count - i, s->size), b->rows + i, least(b->column_count - j, s->size),
                                                              b->columns + j, b->out + (size_t)(3 * i) * (size_t)b->ld + 3 * j, b->ld}, why);
    return status;
}

/* Lists those of `nodes` for which some block with `others` is not cached. Returns how many there are. */
static int list_missing(const block_cache *c, int count, const int *nodes, int other_count, const int *others, int *missing) {
    int found = 0;
    for (int i = 0; i < count; i++) {
        bool all = true;
        for (int j = 0; j < other_count && all; j++) all = block_cache_knows(c, nodes[i], others[j]);
        if (!all) missing[found++] = nodes[i];
    }
    return found;
}

static trocar_status compute_missing(block_cache *c, const block_source *s, const inverse_blocks *b, trocar_error *why) {
    int rows[BLOCK_CACHE_NODES], columns[BLOCK_CACHE_NODES], ld = 3 * s->size;
    int row_end = list_missing(c, b->row_count, b->rows, b->column_count, b->columns, rows);
    int column_end = list_missing(c, b->column_count, b->columns, row_end, rows, columns);
    for (int i = 0; i < row_end; i += s->size)
        for (int j = 0; j < column_end; j += s->size) {
            int high = least(row_end - i, s->size), wide = least(column_end - j, s->size);
            trocar_status status = s->compute(s->context, &(inverse_blocks){high, rows + i, wide, columns + j, s->tile, ld}, why);
            if (status != TROCAR_OK) return status;
            for (int k = 0; k < high * wide; k++)
                block_cache_put(c, rows[i + k / wide], columns[j + k % wide], s->tile + 3 * (k / wide) * ld + 3 * (k % wide), ld);
        }
    return TROCAR_OK;
}

trocar_status block_cache_gather(block_cache *c, const block_source *source, const inverse_blocks *b, trocar_error *why) {
    if (!block_cache_take(c, b->row_count, b->rows, b->column_count, b->columns)) return gather_afresh(source, b, why);
    trocar_status status = compute_missing(c, source, b, why);
    for (int i = 0; i < b->row_count && status == TROCAR_OK; i++)
        for (int j = 0; j < b->column_count; j++)
            block_cache_get(c, b->rows[i], b->columns[j], b->out + (size_t)(3 * i) * (size_t)b->ld + 3 * j, b->ld);
    return status;
}
