/* The interface that every implementation of K^-1 provides. Only the implementations include this. */
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
    void (*release)(inverse *inv);                                          /* frees everything except the common part, struct inverse */
    bool (*prefetches)(const inverse *inv);                                 /* see inverse_prefetches; NULL means false */
    bool (*holds)(const inverse *inv, int node);                            /* see inverse_holds; NULL means true */
    int (*slice)(const inverse *inv);                                       /* see inverse_slice; NULL means INT_MAX */
} inverse_owner;

/* The part common to all implementations; it must be the first member of each implementation's struct. */
struct inverse {
    const inverse_owner *owner;
    tissue *tissue;
    pthread_mutex_t apply_lock;             /* protects the scratch memory of inverse_apply */
    double *force, *displacement; /* [dof_count]: scratch memory of inverse_apply */
};

/* Computes displacement = K^-1 force, with dof_count entries each. Other threads may use the inverse at the same time. */
void inverse_apply_locked(inverse *inv, const double *force, double *displacement);

trocar_status inverse_init(inverse *inv, const inverse_owner *owner, tissue *t, trocar_error *why);

#endif
