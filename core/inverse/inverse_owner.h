/* What an owner of K^-1 provides; for the owners' files only. */
#ifndef TROCAR_INVERSE_OWNER_H
#define TROCAR_INVERSE_OWNER_H

#include <threads.h>

#include "inverse/inverse.h"

typedef struct {
    const char *name;
    trocar_status (*gather)(inverse *inv, int row_count, const int *rows, int column_count, const int *columns, double *out, int ld, report *why);
    void (*apply)(inverse *inv, const double *force, double *displacement); /* dof_count each */
    trocar_status (*prepare)(inverse *inv, report *why);                    /* NULL: nothing was put off */
    void (*release)(inverse *inv);                                          /* all but the shared part */
    bool prefetches;                                                        /* see inverse_prefetches */
    bool (*holds)(const inverse *inv, int node);                            /* NULL: all nodes */
} inverse_owner;

/* First member of every owner's struct. */
struct inverse {
    const inverse_owner *owner;
    tissue *tissue;
    mtx_t apply_lock;             /* of inverse_apply's scratch and the owner's */
    double *force, *displacement; /* dof_count: scratch of inverse_apply */
};

trocar_status inverse_init(inverse *inv, const inverse_owner *owner, tissue *t, report *why);

#endif
