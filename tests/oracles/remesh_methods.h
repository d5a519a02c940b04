/* Remeshing methods that are only needed for comparison, in addition to those of the library: the paper's methods, which update the whole dense
   inverse. */
#ifndef TROCAR_ORACLES_REMESH_METHODS_H
#define TROCAR_ORACLES_REMESH_METHODS_H

#include "remesh/remesh.h"

/* The numbers follow those of the library's methods. */
enum {
    REMESH_WOODBURY = REMESH_METHODS, /* the paper's eq. 4 in one triangle */
    REMESH_WOODBURY_GENERAL, /* the same in the full matrix */
    REMESH_BCS,              /* the paper's eq. 3, boundary-condition switches one by one */
    REMESH_BCS_BLOCKED,      /* the same, all switches of a patch at once */
    ALL_REMESH_METHODS,
};

bool any_remesh_needs_dense(int method);
const char *any_remesh_name(int method);

/* Like remesher_create. BAD_INPUT if the method needs a dense inverse that `inv` does not store. */
trocar_status any_remesher_create(inverse *inv, int method, remesher **created, report *why);

#endif
