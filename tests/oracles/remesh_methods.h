/* Nested addition, the library's own remeshing method, alongside methods that are only needed for comparison. */
#ifndef TROCAR_ORACLES_REMESH_METHODS_H
#define TROCAR_ORACLES_REMESH_METHODS_H

#include "remesh/remesh.h"

typedef enum {
    REMESH_NESTED,           /* nested addition, the library's own method */
    REMESH_IMPLICIT,         /* low-rank factors of the touched nodes, never multiplied out */
    REMESH_WOODBURY,         /* the paper's eq. 4, on one triangle of the whole dense inverse, which the methods below also store */
    REMESH_WOODBURY_GENERAL, /* the paper's eq. 4, on the full matrix */
    REMESH_BCS,              /* the paper's eq. 3, boundary-condition switches one by one */
    REMESH_BCS_BLOCKED,      /* the paper's eq. 3, all switches of a patch at once */
    REMESH_METHODS,
} remesh_method;

bool remesh_needs_dense(remesh_method method);
const char *remesh_name(remesh_method method);

/* Same as remesher_create. Returns BAD_INPUT if the method needs a dense inverse and `inv` does not store one. */
trocar_status remesher_create_by(inverse *inv, remesh_method method, remesher **created, trocar_error *why);

/* For a method's `add`: fills the new node's part of between_contacts. */
void find_between_contacts(remesher *r, int slot);

#endif
