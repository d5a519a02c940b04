/* Who owns K^-1. Everything above asks for blocks between nodes or for a whole displacement field; how the owner
   gets them (dense, factor, region of interest) is its own affair. */
#ifndef TROCAR_INVERSE_H
#define TROCAR_INVERSE_H

#include "tissue/tissue.h"

typedef struct inverse inverse;

/* The paper's way: the whole 3n x 3n inverse, 8 (3n)^2 bytes. `t` must outlive it. */
trocar_status inverse_create_dense(tissue *t, inverse **created, report *why);

/* A sparse factor; half-solves of nodes are made when asked for and kept as long as there is room. */
static const double SPARSE_CACHE = 1.5e9; /* bytes, the usual choice */
trocar_status inverse_create_sparse(tissue *t, double cache_bytes, inverse **created, report *why);

/* Told how far a long start has come, from 0 to 1; a NULL function is not called. */
typedef struct {
    void (*show)(const char *what, double fraction, void *context);
    void *context;
} inverse_progress;

/* Dense between `nodes`, 8 (3 count)^2 bytes; read from `directory` if it is there (see condensed_cache.h), else computed and
   written. What lies outside falls back to a sparse owner. Factors `t` itself, when the factor is needed: not before the
   first field of displacements or node outside if the inverse was on disk. `notice` says where it came from. */
trocar_status inverse_create_condensed(tissue *t, int count, const int *nodes, const char *directory, inverse_progress progress,
                                       inverse **created, report *notice, report *why);

void inverse_free(inverse *inv);
const char *inverse_name(const inverse *inv);

/* Makes now what would else be made when it is first needed: the condensed owner's factor, minutes on a large mesh. Fails as the
   gather that needs it would. From any thread, beside the others. */
trocar_status inverse_prepare(inverse *inv, report *why);

/* It pays to gather in idle time what will be wanted later: the second time is much cheaper. */
bool inverse_prefetches(const inverse *inv);

/* False where the first such node makes the owner factor the whole matrix: only for what can't be done without. */
bool inverse_holds(const inverse *inv, int node);

/* Blocks of K^-1 between nodes rows[0..row_count) and columns[0..column_count), m/N:
   out[(3 i + a) * ld + 3 j + b]. Rows and columns of fixed nodes are zero. Fails where the factor of the whole matrix is
   needed and can't be made; `out` is then untouched. From any thread; the sparse owner serves one at a time. */
trocar_status inverse_gather(inverse *inv, int row_count, const int *rows, int column_count, const int *columns, double *out, int ld,
                             report *why);

/* u = K^-1 f, both node_count vectors (N -> m); forces on fixed nodes are ignored. Zero where the factor is needed and can't
   be made. From any thread, one at a time. */
void inverse_apply(inverse *inv, const vec3 *force, vec3 *displacement);

/* The dense matrix itself (dof_count square, column-major, full), or NULL where the owner does not keep one. */
const double *inverse_dense(const inverse *inv);
const tissue *inverse_tissue(const inverse *inv);

#endif
