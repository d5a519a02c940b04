/* Blocks of K^-1 that were computed before, between the nodes used most recently: 3 x 3 each, symmetric. */
#ifndef TROCAR_BLOCK_CACHE_H
#define TROCAR_BLOCK_CACHE_H

#include <stdbool.h>
#include <stdint.h>

enum { BLOCK_CACHE_NODES = 1024 }; /* 75 MB */

typedef struct {
    int *place;              /* node_count: where a node is, or -1 */
    int node[BLOCK_CACHE_NODES];        /* whose place it is, or -1 */
    uint64_t used[BLOCK_CACHE_NODES];   /* time of last use */
    uint64_t time;
    bool *known;             /* BLOCK_CACHE_NODES square, symmetric */
    double *blocks;          /* BLOCK_CACHE_NODES square of 3 x 3, row-major; those on and above the diagonal */
} block_cache;

bool block_cache_create(block_cache *c, int node_count);
void block_cache_free(block_cache *c);

/* Gives all these nodes places, taken from the ones not used for longest. False, and nothing changed, when they are too many. */
bool block_cache_take(block_cache *c, int row_count, const int *rows, int column_count, const int *columns);

/* Of nodes that have places. */
bool block_cache_knows(const block_cache *c, int row, int column);
void block_cache_put(block_cache *c, int row, int column, const double *block, int ld);
void block_cache_get(const block_cache *c, int row, int column, double *block, int ld);

#endif
