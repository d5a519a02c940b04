/* The worker's job: keep the inverse of the refined stiffness matrix at the few nodes that the needle can touch.
   See README.md, "Node addition is a nested refinement" and "Remeshing methods". */
#ifndef TROCAR_REMESH_H
#define TROCAR_REMESH_H

#include "refinement.h"

enum {
    MAX_WINDOW = 96,                            /* nominal nodes around the tip, behind it and ahead */
    MAX_HANDLES = MAX_CONTACTS + MAX_WINDOW,
    SNAPSHOT_LD = 3 * MAX_HANDLES,
};

/* What the tick wants to be known about the tissue next: a complete description, so that only the newest counts. */
typedef struct {
    uint64_t serial;
    refinement wanted;
    int window_count;
    int window[MAX_WINDOW];  /* nominal nodes */
} remesh_request;

/* The answer: the inverse of the refined stiffness matrix between handles. Added node i is handle i, window entry k is
   handle MAX_CONTACTS + k. Immutable once handed over. */
typedef struct {
    uint64_t serial;         /* of the request that it answers; 0: none yet */
    int added_count;
    uint64_t ids[MAX_CONTACTS];
    int window[MAX_WINDOW];  /* nominal node, or -1 where the place is free */
    double compliance[SNAPSHOT_LD * SNAPSHOT_LD]; /* [(3 i + a) * SNAPSHOT_LD + 3 j + b], m/N */
} compliance_snapshot;

typedef enum {
    REMESH_NESTED,           /* bordered rank-3 form, rows at the handles only: independent of the mesh size */
    REMESH_WOODBURY,         /* the paper's eq. 4 on the full dense inverse */
} remesh_method;

typedef struct remesher remesher;

/* `inv` must outlive it. BAD_INPUT when the method needs a dense inverse that `inv` does not keep. */
trocar_status remesher_create(inverse *inv, remesh_method method, remesher **created, report *why);
void remesher_free(remesher *r);

/* Brings the refined mesh to what is wanted (removals, then additions) and fills the snapshot. Worker's side; allocates nothing. */
trocar_status remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, report *why);

/* Goes back to where it had just answered `request` with `snapshot`, as if nothing had been served since; starts empty where
   the snapshot answers another request. Nested: to the bit. Woodbury: to rounding, as the dense inverse is updated again. */
trocar_status remesher_resume(remesher *r, const remesh_request *request, const compliance_snapshot *snapshot, report *why);

#endif
