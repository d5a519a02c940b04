/* The inverse K^-1 of the stiffness matrix: one interface with three implementations (dense, sparse, condensed). Callers request either blocks between
   nodes or a whole displacement field. */
#ifndef TROCAR_INVERSE_H
#define TROCAR_INVERSE_H

#include "inverse/inverse_blocks.h"
#include "tissue/tissue.h"

typedef struct inverse inverse;

/* Creates a sparse inverse, which computes half-solves with the sparse factor on demand, and caches them. */
static const double SPARSE_CACHE = 1.5e9; /* bytes, default size of the cache */
trocar_status inverse_create_sparse(tissue *t, double cache_bytes, inverse **created, trocar_error *why);

/* Callbacks for long computations, called in the thread that creates the inverse: `show` receives the progress, from 0 to 1; `cancelled` returns nonzero
   to stop. Either may be NULL. */
typedef struct {
    void (*show)(const char *what, double fraction, void *context);
    void *context;
    int (*cancelled)(void *context);
} inverse_progress;

/* Returns CANCELLED if the caller wants to stop. */
trocar_status inverse_go_on(inverse_progress progress, trocar_error *why);

/* Creates a dense inverse, as in the paper (see core/README.md): the whole 3n x 3n matrix for n free nodes, which takes 8 (3n)^2 bytes. `t` must outlive it. */
trocar_status inverse_create_dense(tissue *t, inverse_progress progress, inverse **created, trocar_error *why);

/* Factorises K (see tissue_factor) and reports progress. */
trocar_status inverse_factor(tissue *t, int count, const int *last, inverse_progress progress, trocar_error *why);

typedef struct {
    int count;
    const int *nodes;
    bool single;             /* single precision */
    int threads;             /* number of threads for the condensation, each of which uses single-threaded BLAS; 0 is equivalent to 1 */
    const char *directory;   /* directory of the cache */
    bool must_be_saved;      /* fail (SYSTEM) before computing the inverse if it cannot be saved */
    inverse_progress progress;
} condensed_region;

/* Creates a condensed inverse, which is dense between the region's nodes: 36 count^2 bytes, or half of that in single precision. If it is cached in
   `directory`, it is mapped (see condensed_cache.h); otherwise it is computed and saved. All other nodes are handled by a sparse inverse; `t` is
   factorised when the first of them is requested, and K is assembled on demand. `notice` receives a message about where the inverse came from. */
trocar_status inverse_create_condensed(tissue *t, const condensed_region *region, inverse **created, trocar_error *notice, trocar_error *why);

void inverse_free(inverse *inv);
const char *inverse_name(const inverse *inv);

/* Performs deferred work now: the factorisation needed for nodes outside the region of a condensed inverse, which takes minutes and gigabytes for a large
   mesh. Returns the errors that inverse_gather would return. May be called from any thread, concurrently with the other functions. */
trocar_status inverse_prepare(inverse *inv, trocar_error *why);

/* True if gathering blocks in advance makes later requests for them much cheaper. */
bool inverse_prefetches(const inverse *inv);

/* Returns the maximum number of new nodes to gather in advance at once, chosen so that a request waits for this no longer than a few milliseconds. */
int inverse_slice(const inverse *inv);

/* Returns false if blocks of this node require a factorisation of the whole matrix; such a node should be requested only if it cannot be avoided. */
bool inverse_holds(const inverse *inv, int node);

/* Writes the blocks of K^-1 between these nodes. Rows and columns of fixed nodes are zero. If the factor of the whole matrix is needed but cannot be
   computed, fails and writes nothing. Thread-safe; calls to the sparse inverse are serialised. */
trocar_status inverse_gather(inverse *inv, const inverse_blocks *blocks, trocar_error *why);

/* Computes u = K^-1 f for vectors of node_count entries (N to m); forces on fixed nodes are ignored. With a condensed inverse, the relative residual is
   1e-10. Returns zero displacements if there is no memory or f is not finite. Thread-safe; calls are serialised. */
void inverse_apply(inverse *inv, const vec3 *force, vec3 *displacement);

const tissue *inverse_tissue(const inverse *inv);

#endif
