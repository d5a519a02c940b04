/* What an owner of K^-1 provides; for the owners' files only. */
#ifndef TROCAR_INVERSE_OWNER_H
#define TROCAR_INVERSE_OWNER_H

#include "inverse.h"

typedef struct {
    const char *name;
    void (*gather)(inverse *, int, const int *, int, const int *, double *, int);
    void (*apply)(inverse *, const double *force, double *displacement);  /* dof_count each */
    trocar_status (*prefetch)(inverse *, int, const int *, report *);     /* NULL: everything is at hand */
    void (*release)(inverse *);                                           /* all but the shared part */
    bool prefetches;                                                      /* prefetch pays in idle time */
    bool (*holds)(const inverse *, int node);                             /* NULL: all nodes */
} inverse_owner;

/* First member of every owner's struct. */
struct inverse {
    const inverse_owner *owner;
    tissue *tissue;
    double *force, *displacement; /* dof_count: scratch of inverse_apply */
};

trocar_status inverse_init(inverse *inv, const inverse_owner *owner, tissue *t, report *why);

#endif
