/* Interface of the implementations of K^-1; included by their files only. */
#ifndef TROCAR_INVERSE_OWNER_H
#define TROCAR_INVERSE_OWNER_H

#include <pthread.h>

#include "inverse/inverse_blocks.h"
#include "tissue/tissue.h"

typedef struct inverse inverse; /* inverse.h */

typedef struct {
    const char *name;
    trocar_status (*gather)(inverse *inv, const inverse_blocks *blocks, report *why);
    void (*apply)(inverse *inv, const double *force, double *displacement); /* dof_count each */
    trocar_status (*prepare)(inverse *inv, report *why);                    /* NULL: no deferred work */
    void (*release)(inverse *inv);                                          /* frees everything except the common part */
    bool (*prefetches)(const inverse *inv);                                 /* see inverse_prefetches; NULL: false */
    bool (*holds)(const inverse *inv, int node);                            /* NULL: all nodes */
    int (*slice)(const inverse *inv);                                       /* see inverse_slice; NULL: INT_MAX */
} inverse_owner;

/* Common part, first member of each implementation's struct. */
struct inverse {
    const inverse_owner *owner;
    tissue *tissue;
    pthread_mutex_t apply_lock;             /* protects the scratch memory of inverse_apply */
    double *force, *displacement; /* dof_count: scratch of inverse_apply */
};

trocar_status inverse_init(inverse *inv, const inverse_owner *owner, tissue *t, report *why);

#endif
