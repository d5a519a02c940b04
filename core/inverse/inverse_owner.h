/* The interface that each implementation of K^-1 provides; included by the implementations only. */
#ifndef TROCAR_INVERSE_OWNER_H
#define TROCAR_INVERSE_OWNER_H

#include <pthread.h>

#include "inverse/inverse_blocks.h"
#include "tissue/tissue.h"

typedef struct inverse inverse; /* inverse.h */

typedef struct {
    const char *name;
    trocar_status (*gather)(inverse *inv, const inverse_blocks *blocks, trocar_error *why);
    void (*apply)(inverse *inv, const double *force, double *displacement); /* vectors of dof_count entries each */
    trocar_status (*prepare)(inverse *inv, trocar_error *why);                    /* NULL if no work is ever deferred */
    void (*release)(inverse *inv);                                          /* frees everything except the common part */
    bool (*prefetches)(const inverse *inv);                                 /* see inverse_prefetches; NULL is equivalent to false */
    bool (*holds)(const inverse *inv, int node);                            /* see inverse_holds; NULL if it holds all nodes */
    int (*slice)(const inverse *inv);                                       /* see inverse_slice; NULL is equivalent to INT_MAX */
} inverse_owner;

/* Common part of all implementations; the first member of each implementation's struct. */
struct inverse {
    const inverse_owner *owner;
    tissue *tissue;
    pthread_mutex_t apply_lock;             /* protects the scratch memory of inverse_apply */
    double *force, *displacement; /* [dof_count]: scratch memory of inverse_apply */
};

/* Applies an inverse that other threads may use at the same time: force and displacement have dof_count entries each. */
void inverse_apply_locked(inverse *inv, const double *force, double *displacement);

trocar_status inverse_init(inverse *inv, const inverse_owner *owner, tissue *t, trocar_error *why);

#endif
