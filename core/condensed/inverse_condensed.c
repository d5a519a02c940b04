#include "inverse/inverse.h"

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#include "base/memory.h"
#include "condensed/coarse_space.h"
#include "condensed/condensation.h"
#include "condensed/condensed_cache.h"
#include "condensed/conjugate_gradients.h"
#include "inverse/inverse_owner.h"

/* The dense inverse K^-1_RR between the nodes of a region of interest. Displacement fields are computed by conjugate gradients, which need far less memory
   than a factor of K. Blocks of other nodes come from a sparse inverse that is created on first use. Thus, if the dense inverse comes from the cache, neither
   K nor its factor is needed to start. */
typedef struct {
    inverse shared;
    int *nodes;              /* matrix.count free nodes of the region, in the order of the matrix */
    int *place;              /* [node_count]: index of each mesh node in `nodes`, or -1 */
    symmetric_blocks matrix; /* m/N */
    file_mapping mapping;    /* the mapped cache file that holds the matrix; empty if the matrix is allocated */
    pthread_mutex_t assembling;        /* protects K until it is assembled: the worker, the display and inverse_prepare may all need it first */
    pthread_mutex_t factoring;         /* protects the next three members and the factor; may be held for minutes, but displacement fields do not need it */
    _Atomic(inverse *) rest; /* sparse inverse for other nodes; NULL if not needed yet, or if it could not be created */
    trocar_status rest_status;
    trocar_error no_rest;    /* why `rest` could not be created */
    coarse_space *coarse;    /* coarse space for conjugate gradients; NULL if not needed yet, discarded, or if it could not be created */
    bool coarse_sought;
    int given_count, *given; /* the region's nodes in the caller's order */
} condensed_inverse;

/* ---- the rest of the body --------------------------------------------------------------------------------------------- */

/* Assembles K once. After that, other threads may read it. */
static trocar_status assemble(condensed_inverse *c, trocar_error *why) {
    tissue *t = c->shared.tissue;
    if (atomic_load(&t->assembled)) return TROCAR_OK;
    pthread_mutex_lock(&c->assembling);
    trocar_status status = tissue_stiffness(t, why);
    pthread_mutex_unlock(&c->assembling);
    return status;
}

/* True if the sparse inverse could not be created and we should not try again, because each attempt may take minutes. If there was too little memory to start,
   we try again once there is enough. */
static bool is_final(const condensed_inverse *c) {
    double refused = c->shared.tissue->refused;
    return c->rest_status != TROCAR_OK && !(c->rest_status == TROCAR_NO_MEMORY && refused > 0.0 && refused <= memory_available());
}

/* Returns the sparse inverse for other nodes, creating it on first use. */
static trocar_status rest_of(condensed_inverse *c, inverse **rest, trocar_error *why) {
    pthread_mutex_lock(&c->factoring);
    inverse *created = c->rest;
    if (!created && !is_final(c)) {
        c->rest_status = assemble(c, &c->no_rest); /* assemble K first, so that displacement fields need not wait for the factor */
        if (c->rest_status == TROCAR_OK) c->rest_status = tissue_factor(c->shared.tissue, c->given_count, c->given, &c->no_rest);
        if (c->rest_status == TROCAR_OK) c->rest_status = inverse_create_sparse(c->shared.tissue, SPARSE_CACHE, &created, &c->no_rest);
        c->rest = created;
    }
    trocar_status status = c->rest_status;
    *rest = created;
    if (status != TROCAR_OK) *why = c->no_rest;
    pthread_mutex_unlock(&c->factoring);
    return status;
}

static trocar_status condensed_prepare(inverse *inv, trocar_error *why) {
    inverse *rest;
    return rest_of((condensed_inverse *)inv, &rest, why);
}

static bool is_inside(const condensed_inverse *c, int count, const int *nodes) {
    for (int i = 0; i < count; i++)
        if (c->place[nodes[i]] < 0 && c->shared.tissue->dof[nodes[i]] >= 0) return false;
    return true;
}

static void look_up(const condensed_inverse *c, int row, int column, double *out, int ld) {
    if (c->place[row] >= 0 && c->place[column] >= 0) {
        symmetric_blocks_get(&c->matrix, c->place[row], c->place[column], out, ld);
        return;
    }
    for (int a = 0; a < 3; a++) memset(out + (size_t)a * (size_t)ld, 0, 3 * sizeof *out); /* nodes in the region but not in the matrix are fixed */
}

/* Copies the blocks if all nodes are in the region; otherwise gets them from the sparse inverse. */
static trocar_status condensed_gather(inverse *inv, const inverse_blocks *blocks, trocar_error *why) {
    condensed_inverse *c = (condensed_inverse *)inv;
    if (!is_inside(c, blocks->row_count, blocks->rows) || !is_inside(c, blocks->column_count, blocks->columns)) {
        inverse *rest;
        trocar_status status = rest_of(c, &rest, why);
        return status == TROCAR_OK ? inverse_gather(rest, blocks, why) : status;
    }
    for (int i = 0; i < blocks->row_count; i++)
        for (int j = 0; j < blocks->column_count; j++)
            look_up(c, blocks->rows[i], blocks->columns[j], blocks->out + (size_t)(3 * i) * (size_t)blocks->ld + 3 * j, blocks->ld);
    return TROCAR_OK;
}

static const double FIELD_TOLERANCE = 1e-10; /* norm of the residual relative to that of the force */
enum { COARSE_STEPS = 1000 };                /* iteration limit with a coarse space; 45 iterations are enough for 20 000 as well as for 45 000 nodes */
enum { FIELD_STEPS = 20000 };                /* iteration limit without one; 3000 iterations are enough for 4985 nodes, nu = 0.499 and a gland 2000 times as
                                                stiff as its surroundings */

/* Solves by conjugate gradients. If they converge only without the coarse space, discards it. This happens, for example, with nu = 0.499 and a gland 2000
   times as stiff as its surroundings. */
static bool search(condensed_inverse *c, const double *force, double *displacement) {
    const tissue *t = c->shared.tissue;
    if (!c->coarse_sought) c->coarse = coarse_space_create(t);
    c->coarse_sought = true;
    if (c->coarse && conjugate_gradients(t->stiffness, c->coarse, FIELD_TOLERANCE, COARSE_STEPS, force, displacement)) return true;
    if (!conjugate_gradients(t->stiffness, NULL, FIELD_TOLERANCE, FIELD_STEPS, force, displacement)) return false;
    coarse_space_free(c->coarse);
    c->coarse = NULL;
    return true;
}

/* Starts iterating from the last call's displacements, because consecutive fields differ little. */
static void condensed_apply(inverse *inv, const double *force, double *displacement) {
    condensed_inverse *c = (condensed_inverse *)inv;
    tissue *t = inv->tissue;
    trocar_error why;
    bool forced = false;
    for (int i = 0; i < t->dof_count && !forced; i++) forced = force[i] != 0.0;
    inverse *rest = c->rest;
    if (forced && rest) {
        rest->owner->apply(rest, force, displacement);
        return;
    }
    if (!forced || assemble(c, &why) != TROCAR_OK || !search(c, force, displacement))
        memset(displacement, 0, (size_t)t->dof_count * sizeof *force);
}

static void condensed_release(inverse *inv) {
    condensed_inverse *c = (condensed_inverse *)inv;
    inverse_free(c->rest);
    coarse_space_free(c->coarse);
    pthread_mutex_destroy(&c->assembling);
    pthread_mutex_destroy(&c->factoring);
    free(c->nodes);
    free(c->place);
    free(c->given);
    if (c->mapping.at) munmap(c->mapping.at, c->mapping.bytes);
    else free(c->matrix.numbers);
}

static bool condensed_holds(const inverse *inv, int node) { return is_inside((const condensed_inverse *)inv, 1, &node); }

static const inverse_owner condensed_owner = {"condensed", condensed_gather, condensed_apply, condensed_prepare, condensed_release, NULL,
                                              condensed_holds, NULL};

/* ---- creation --------------------------------------------------------------------------------------------------------- */

/* Maps the matrix from the cache or, if it is not cached, computes it and saves it there. */
static trocar_status fill(condensed_inverse *c, const condensed_region *region, trocar_error *notice, trocar_error *why) {
    const tissue *t = c->shared.tissue;
    int count = c->matrix.count;
    condensed_cache cache = condensed_cache_find(region->directory, t, region->count, region->nodes, region->single);
    cache_state found = condensed_cache_map(&cache, c->nodes, &c->matrix, &c->mapping);
    bool known = found == CACHE_READ;
    for (int i = 0; i < count && known; i++) known = c->nodes[i] >= 0 && c->nodes[i] < t->mesh->node_count && t->dof[c->nodes[i]] >= 0;
    if (known) {
        snprintf(notice->text, sizeof notice->text, "%d nodes, read from %.900s", count, cache.path);
        return TROCAR_OK;
    }
    if (c->mapping.at) munmap(c->mapping.at, c->mapping.bytes);
    c->mapping = (file_mapping){0};
    c->matrix.numbers = NULL;
    double needed;
    trocar_status status = region->must_be_saved ? condensed_cache_check(&cache, &c->matrix, why) : TROCAR_OK;
    if (status != TROCAR_OK) return status;
    status = condense(c->shared.tissue, region, c->nodes, &c->matrix, &needed, why);
    if (status == TROCAR_NO_MEMORY || needed == INFINITY) {
        size_t used = strlen(why->text);
        snprintf(why->text + used, sizeof why->text - used, "; a file made on another machine is used if it is copied to %.600s", cache.path);
    }
    if (status == TROCAR_NO_MEMORY && needed > memory_most()) return TROCAR_BAD_INPUT; /* can never succeed on this machine */
    if (status != TROCAR_OK) return status;
    snprintf(notice->text, sizeof notice->text, "%d nodes, %s %.900s", count,
             found == CACHE_ABSENT ? "written to" : "damaged, rewritten to", cache.path);
    trocar_error unwritten;
    status = condensed_cache_write(&cache, c->nodes, &c->matrix, &unwritten);
    if (status == TROCAR_OK) return status;
    *(region->must_be_saved ? why : notice) = unwritten;
    return region->must_be_saved ? status : TROCAR_OK;
}

trocar_status inverse_create_condensed(tissue *t, const condensed_region *region, inverse **created, trocar_error *notice, trocar_error *why) {
    int count = region->count;
    condensed_inverse *c = calloc(1, sizeof *c);
    *created = c ? &c->shared : NULL;
    if (!c) return fail(why, TROCAR_NO_MEMORY, "no memory");
    pthread_mutex_init(&c->assembling, NULL);
    pthread_mutex_init(&c->factoring, NULL);
    trocar_status status = inverse_init(&c->shared, &condensed_owner, t, why);
    size_t all = (size_t)t->mesh->node_count;
    c->matrix.single = region->single;
    for (int i = 0; i < count; i++) c->matrix.count += t->dof[region->nodes[i]] >= 0;
    c->given_count = count;
    c->given = malloc(((size_t)count + 1) * sizeof *c->given);
    c->nodes = malloc(((size_t)count + 1) * sizeof *c->nodes);
    c->place = malloc(all * sizeof *c->place);
    if (status == TROCAR_OK && !(c->given && c->nodes && c->place)) status = fail(why, TROCAR_NO_MEMORY, "no memory for %d nodes", count);
    if (status == TROCAR_OK && c->matrix.count == 0)
        status = fail(why, TROCAR_BAD_INPUT, "inverse: condensed needs a region_of_interest with nodes that are not fixed");
    if (status == TROCAR_OK) {
        memcpy(c->given, region->nodes, (size_t)count * sizeof *c->given);
        status = fill(c, region, notice, why);
    }
    if (status != TROCAR_OK) {
        inverse_free(&c->shared);
        *created = NULL;
        return status;
    }
    for (size_t i = 0; i < all; i++) c->place[i] = -1;
    for (int i = 0; i < c->matrix.count; i++) c->place[c->nodes[i]] = i;
    return TROCAR_OK;
}
