/* The inverse K^-1 of the stiffness matrix: one interface, three implementations (dense, sparse, condensed). Callers request blocks between nodes or whole
   displacement fields. */
#ifndef TROCAR_INVERSE_H
#define TROCAR_INVERSE_H

#include "inverse/inverse_blocks.h"
#include "tissue/tissue.h"

typedef struct inverse inverse;

/* Creates a sparse inverse, which computes half-solves with the sparse factor on demand and caches them. */
static const double SPARSE_CACHE = 1.5e9; /* bytes, default size of the cache */
trocar_status inverse_create_sparse(tissue *t, double cache_bytes, inverse **created, trocar_error *why);

/* Callbacks for long computations, called in the thread that creates the inverse. `show` reports progress, from 0 to 1; `cancelled` returns nonzero to stop.
   Either may be NULL. */
typedef struct {
    void (*show)(const char *what, double fraction, void *context);
    void *context;
    int (*cancelled)(void *context);
} inverse_progress;

/* Returns CANCELLED if the caller wants to stop. */
trocar_status inverse_go_on(inverse_progress progress, trocar_error *why);

/* Creates a dense inverse, as in the paper (see core/README.md): the whole 3n x 3n matrix for n free nodes. It takes 8 (3n)^2 bytes. `t` must outlive it. */
trocar_status inverse_create_dense(tissue *t, inverse_progress progress, inverse **created, trocar_error *why);

/* Factorises K (see tissue_factor) and reports progress. */
trocar_status inverse_factor(tissue *t, int count, const int *last, inverse_progress progress, trocar_error *why);

typedef struct {
    int count;
    const int *nodes;
    bool single;             /* single precision */
    int threads;             /* number of threads for the condensation, each using single-threaded BLAS; 0 means 1 */
    const char *directory;   /* cache directory */
    bool must_be_saved;      /* if the inverse could not be saved, fail (SYSTEM) before computing it */
    inverse_progress progress;
} condensed_region;

/* Creates a condensed inverse: dense between the region's nodes (36 count^2 bytes, or half that in single precision), with a sparse inverse for all other
   nodes. If the dense part is cached in `directory`, maps it (see condensed_cache.h); otherwise computes and saves it. K is assembled on demand, and `t` is
   factorised when a node outside the region is first requested. `notice` receives a message saying where the inverse came from. */
trocar_status inverse_create_condensed(tissue *t, const condensed_region *region, inverse **created, trocar_error *notice, trocar_error *why);

void inverse_free(inverse *inv);
const char *inverse_name(const inverse *inv);

/* Does deferred work now: the factorisation that a condensed inverse needs for nodes outside its region. On a large mesh, this takes minutes and gigabytes of
   memory. Errors as in inverse_gather. Any thread may call this while others use the inverse. */
trocar_status inverse_prepare(inverse *inv, trocar_error *why);

/* True if it pays to gather blocks in advance, because later requests for them are then much faster. */
bool inverse_prefetches(const inverse *inv);

/* Returns how many new nodes to gather in advance at a time, at most. Limits how long this can hold up a request to a few milliseconds. */
int inverse_slice(const inverse *inv);

/* Returns false if blocks of this node require factorising the whole matrix. Do not request such a node unless you must. */
bool inverse_holds(const inverse *inv, int node);

/* Writes the blocks of K^-1 between these nodes. Rows and columns of fixed nodes are zero. If the factor of the whole matrix is needed but cannot be
   computed, fails and writes nothing. Thread-safe; calls to the sparse inverse are serialised. */
trocar_status inverse_gather(inverse *inv, const inverse_blocks *blocks, trocar_error *why);

/* Computes the displacements (m) u = K^-1 f for forces f (N), with node_count entries each. Ignores forces on fixed nodes. With a condensed inverse, the
   relative residual is 1e-10. Returns zero displacements if out of memory or if f is not finite. Thread-safe; calls are serialised. */
void inverse_apply(inverse *inv, const vec3 *force, vec3 *displacement);

const tissue *inverse_tissue(const inverse *inv);

#endif
