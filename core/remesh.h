/* Mesh refinement along the needle: nodes added inside elements, and the compliance of the refined mesh seen at
   the few nodes that the needle can touch. See README.md, "Node addition is a nested refinement". */
#ifndef TROCAR_REMESH_H
#define TROCAR_REMESH_H

#include "inverse.h"

enum {
    MAX_CONTACTS = 64,                          /* added nodes alive at once */
    MAX_WINDOW = 96,                            /* nominal nodes around the tip, behind it and ahead */
    MAX_HANDLES = MAX_CONTACTS + MAX_WINDOW,
    SNAPSHOT_LD = 3 * MAX_HANDLES,
};

/* A node that the insertion adds to the nominal mesh. */
typedef struct {
    uint64_t id;             /* never used twice in one insertion state */
    int tet;                 /* nominal element that contains it */
    vec3 position;           /* nominal, m; strictly inside its leaf */
    int corners[4];          /* the leaf that it splits: nominal node >= 0, added node -1 - index */
    double weights[4];       /* its barycentric weights there */
} added_node;

/* The refined part of the mesh: added nodes in order of creation; each splits the leaf that contains it in four. */
typedef struct {
    int count;
    added_node nodes[MAX_CONTACTS];
} refinement;

/* A point of the refined mesh: leaf corners (coded as above) and barycentric weights. */
typedef struct {
    int corners[4];
    double weights[4];
} leaf_point;

/* The leaf of nominal element `tet` that contains x, counting only the first `active` added nodes. */
leaf_point refinement_locate(const mesh *m, const refinement *r, int active, int tet, vec3 x);

/* Appends a node at x in `tet`, shifted inside where x is nearly on a face of its leaf. Returns its index, or -1 when full. */
int refinement_add(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id);

/* Compliance d^-1 of the hierarchical surplus of a node at this leaf point, m/N: what adding it contributes. */
mat3 surplus_compliance(const tissue *t, const refinement *r, int tet, const leaf_point *at);

/* What the tick wants to be known about the tissue next: a complete description, so that only the newest counts. */
typedef struct {
    uint64_t serial;
    refinement wanted;
    int window_count;
    int window[MAX_WINDOW];  /* nominal nodes */
} remesh_request;

/* The answer: the inverse of the refined stiffness matrix between handles (added nodes first, then the window).
   Immutable once handed over. */
typedef struct {
    uint64_t serial;         /* of the request that it answers; 0: none yet */
    int added_count;
    uint64_t ids[MAX_CONTACTS];
    int window_count;
    int window[MAX_WINDOW];
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

#endif
