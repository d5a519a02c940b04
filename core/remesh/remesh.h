/* The worker's job: keep the inverse of the refined stiffness matrix at the few nodes that the needle can touch.
   See README.md, "Node addition is a nested refinement" and "Remeshing methods". */
#ifndef TROCAR_REMESH_H
#define TROCAR_REMESH_H

#include "inverse/inverse.h"
#include "remesh/refinement.h"

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
    int needed;              /* so many at the window's front; the others may be left out where they are costly (inverse_holds) */
    vec3 tip, direction;     /* m, the needle's line (unit vector, or zero: unknown): remesher_look_ahead follows it */
} remesh_request;

/* The answer: the inverse of the refined stiffness matrix between handles. Contact node i is handle i, window entry k is
   handle MAX_CONTACTS + k; rows of handles not in use mean nothing. Immutable once handed over. */
typedef struct {
    uint64_t serial;         /* of the request that it answers; 0: none yet */
    int added_count;
    uint64_t ids[MAX_CONTACTS];
    int window[MAX_WINDOW];  /* nominal node, or -1 where the place is free */
    double compliance[SNAPSHOT_LD * SNAPSHOT_LD]; /* [(3 i + a) * SNAPSHOT_LD + 3 j + b], m/N */
} compliance_snapshot;

/* How the inverse follows the changes of the mesh. The first two form rows at the handles only, whatever the mesh's size; the
   others update the full dense inverse. All take every kind of contact node, but for nested, which moves none. */
typedef enum {
    REMESH_NESTED,           /* bordered rank-3 form */
    REMESH_IMPLICIT,         /* low-rank factors of the nodes touched, never multiplied out */
    REMESH_WOODBURY,         /* the paper's eq. 4 in one triangle */
    REMESH_WOODBURY_GENERAL, /* the same in the full matrix */
    REMESH_BCS,              /* the paper's eq. 3, boundary-condition switches one by one */
    REMESH_BCS_BLOCKED,      /* the same, all switches of a patch at once */
    REMESH_METHODS,
} remesh_method;

typedef struct remesher remesher;

bool remesh_needs_dense(remesh_method method);
const char *remesh_name(remesh_method method);

/* `inv` must outlive it. BAD_INPUT when the method needs a dense inverse that `inv` does not keep. */
trocar_status remesher_create(inverse *inv, remesh_method method, remesher **created, report *why);
void remesher_free(remesher *r);

/* Brings the refined mesh to what is wanted (removals from the end, then the new nodes in order) and fills the snapshot.
   Worker's side; allocates nothing. */
trocar_status remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, report *why);

/* Makes ready what the owner of the inverse will need further along the line of the last request served, one slice at a
   time, nearest first. False: nothing is left to do. For idle time; changes no answer. */
bool remesher_look_ahead(remesher *r);

/* Goes back to where it had just answered `request` with `snapshot`, as if nothing had been served since; starts empty where
   the snapshot answers another request. To the bit or to rounding: see simulation_restore. */
trocar_status remesher_resume(remesher *r, const remesh_request *request, const compliance_snapshot *snapshot, report *why);

#endif
