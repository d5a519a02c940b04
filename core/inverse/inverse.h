/* The inverse K^-1 of the stiffness matrix, behind one interface with three implementations (dense, sparse, condensed). Callers
   request blocks between nodes, or a whole displacement field. */
#ifndef TROCAR_INVERSE_H
#define TROCAR_INVERSE_H

#include "inverse/inverse_blocks.h"
#include "tissue/tissue.h"

typedef struct inverse inverse;

/* Sparse factor; half-solves of nodes are computed on demand and cached. */
static const double SPARSE_CACHE = 1.5e9; /* bytes, default size of the cache */
trocar_status inverse_create_sparse(tissue *t, double cache_bytes, inverse **created, report *why);

/* Callbacks of a long start-up, called in the thread that makes the inverse: one receives the progress, 0 to 1, the other says whether to give up.
   Both may be NULL. */
typedef struct {
    void (*show)(const char *what, double fraction, void *context);
    void *context;
    int (*cancelled)(void *context);
} inverse_progress;

/* Returns CANCELLED if the caller wants to give up. */
trocar_status inverse_go_on(inverse_progress progress, report *why);

/* The paper's method: the whole 3n x 3n inverse, 8 (3n)^2 bytes. `t` must outlive it. */
trocar_status inverse_create_dense(tissue *t, inverse_progress progress, inverse **created, report *why);

/* Factorises K (see tissue_factor) and reports progress. */
trocar_status inverse_factor(tissue *t, int count, const int *last, inverse_progress progress, report *why);

typedef struct {
    int count;
    const int *nodes;
    bool single;             /* precision */
    int threads;             /* for condensing, with BLAS at one thread; 0: one */
    const char *directory;   /* of the cache */
    bool must_be_saved;      /* fail (SYSTEM) before computing if the inverse cannot be saved */
    inverse_progress progress;
} condensed_region;

/* Dense between the region's nodes, 36 count^2 bytes, half of that in single precision. Mapped from `directory` if cached there (see
   condensed_cache.h), else computed and saved. A sparse inverse handles other nodes; `t` is factorised when the first of them is needed, and K is
   assembled on demand. `notice` receives the source. */
trocar_status inverse_create_condensed(tissue *t, const condensed_region *region, inverse **created, report *notice, report *why);

void inverse_free(inverse *inv);
const char *inverse_name(const inverse *inv);

/* Does deferred work now: the factorisation for nodes outside a condensed inverse's region, which takes a minute or more, and gigabytes, on a large
   mesh. Returns the same errors as the gather that needs it. May be called from any thread, concurrently with the other functions. */
trocar_status inverse_prepare(inverse *inv, report *why);

/* True if gathering blocks in advance makes gathering them again much cheaper. */
bool inverse_prefetches(const inverse *inv);

/* How many new nodes may be gathered in advance at once, so that a request waits for them for at most some milliseconds. */
int inverse_slice(const inverse *inv);

/* False if blocks of this node would require factorising the whole matrix; request them only if they are indispensable. */
bool inverse_holds(const inverse *inv, int node);

/* Writes the blocks of K^-1 between these nodes. Rows and columns of fixed nodes are zero. Fails, and writes nothing, if the factor of the whole
   matrix is needed but cannot be computed. Thread-safe; calls to the sparse inverse are serialised. */
trocar_status inverse_gather(inverse *inv, const inverse_blocks *blocks, report *why);

/* Computes u = K^-1 f, both node_count vectors (N -> m); forces on fixed nodes are ignored. With a condensed inverse K u differs from f by 1e-10 of
   f. Returns zero if memory is missing or f is not finite. Thread-safe; calls are serialised. */
void inverse_apply(inverse *inv, const vec3 *force, vec3 *displacement);

const tissue *inverse_tissue(const inverse *inv);

#endif
