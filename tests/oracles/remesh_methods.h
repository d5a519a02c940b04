/* Remeshing methods that are needed only for comparison, in addition to those of the library: the paper's methods, which update the whole dense inverse. */
#ifndef TROCAR_ORACLES_REMESH_METHODS_H
#define TROCAR_ORACLES_REMESH_METHODS_H

#include "remesh/remesh.h"

/* The numbering continues that of the library's methods. */
enum {
    REMESH_WOODBURY = REMESH_METHODS, /* the paper's eq. 4, on one triangle of the matrix */
    REMESH_WOODBURY_GENERAL, /* the paper's eq. 4, on the full matrix */
    REMESH_BCS,              /* the paper's eq. 3, boundary-condition switches one by one */
    REMESH_BCS_BLOCKED,      /* the paper's eq. 3, all switches of a patch at once */
    ALL_REMESH_METHODS,
};

bool any_remesh_needs_dense(int method);
const char *any_remesh_name(int method);

/* Like remesher_create. Returns BAD_INPUT if the method needs a dense inverse and `inv` does not store one. */
trocar_status any_remesher_create(inverse *inv, int method, remesher **created, trocar_error *why);

#endif
