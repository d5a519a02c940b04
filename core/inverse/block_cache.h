/* Caches the 3 x 3 blocks of a symmetric inverse between the most recently used nodes. */
#ifndef TROCAR_BLOCK_CACHE_H
#define TROCAR_BLOCK_CACHE_H

#include <stdbool.h>

#include "base/error.h"
#include "inverse/inverse_blocks.h"
#include "inverse/lru.h"

enum { BLOCK_CACHE_NODES = 1024 }; /* number of cached nodes; the blocks between them take up 75 MB */

typedef struct {
    lru nodes;               /* BLOCK_CACHE_NODES slots; a node's slot is its row and column in the arrays below */
    bool *known;             /* [BLOCK_CACHE_NODES][BLOCK_CACHE_NODES], symmetric: true if the block is cached */
    double *blocks;          /* [BLOCK_CACHE_NODES][BLOCK_CACHE_NODES][3][3]; only blocks on and above the diagonal are used */
} block_cache;

bool block_cache_create(block_cache *c, int node_count);
void block_cache_free(block_cache *c);

/* Where blocks come from that are not cached: computes up to `size` x `size` blocks at a time. */
typedef struct {
    trocar_status (*compute)(void *context, const inverse_blocks *tile, trocar_error *why);
    void *context;
    double *tile;            /* scratch, a 3 size x 3 size matrix */
    int size;
} block_source;

/* Copies the cached blocks, and computes and caches the others. If the cache is too small for all the nodes, computes every block and caches none. */
trocar_status block_cache_gather(block_cache *c, const block_source *source, const inverse_blocks *blocks, trocar_error *why);

/* Assigns slots to all these nodes, evicting the least recently used ones. If there are too many nodes, returns false and changes nothing. */
bool block_cache_take(block_cache *c, int row_count, const int *rows, int column_count, const int *columns);

/* Check for, store and read the block between two nodes. Both nodes must have slots. */
bool block_cache_knows(const block_cache *c, int row, int column);
void block_cache_put(block_cache *c, int row, int column, const double *block, int ld);
void block_cache_get(const block_cache *c, int row, int column, double *block, int ld);

#endif
