/* The refined mesh: contact nodes, and leaves, which are the parts of nominal elements into which these nodes split the mesh. refinement.h adds and
   removes nodes. */
#ifndef TROCAR_LEAVES_H
#define TROCAR_LEAVES_H

#include "tissue/resolved_radius.h"

enum {
    MAX_CONTACTS = 64,       /* maximum number of contact nodes at the same time */
    MAX_PATCH = 48,          /* maximum number of nodes touched by one change to the mesh */
    MAX_PATCH_LEAVES = 2 * (MAX_PATCH - 3), /* maximum number of leaves around a moved node: Euler's formula for the sphere of its neighbours */
    MAX_MOVED_PATCHES = 1024,   /* maximum number of nodes touched by all moves together */
    MAX_LEAVES = 1 + 3 * MAX_CONTACTS, /* maximum number of leaves in one nominal element */
};

/* A point of the refined mesh: the corners of its leaf (nominal node >= 0, added node -1 - slot) and its barycentric weights. */
typedef struct {
    int corners[4];
    double weights[4];
} leaf_point;

/* A contact node of the needle. */
typedef struct {
    uint64_t id;             /* unique within one insertion state */
    int tet;                 /* nominal element that contains it */
    vec3 position;           /* m, nominal position */
    int moved;               /* nominal node that was moved to this position; -1 for a separate node, which splits its leaf */
    leaf_point at;           /* the leaf that it splits into four, or into three if one weight is 0, because the node is then on the face opposite that
                                corner */
    int across_tet;          /* for a node on a face, the nominal element of the leaf on the other side; -1 if there is none */
    leaf_point across;       /* the leaf on the other side, which is also split into three */
    int touched;             /* number of nodes in a moved node's patch, including the node itself */
    line_in_tet line;        /* line on which to measure the mesh's resolution at the node: the needle's path past the node. Set by the caller; a zero
                                direction means that it is not measured */
} added_node;

/* The contact nodes. Each keeps its slot and its id from addition to removal; a new node uses the lowest free slot. Each node splits or bends the mesh that
   the nodes before it in `order` have produced. In the functions below, "the first `active` nodes" are those at the front of `order`. */
typedef struct {
    int count;
    int order[MAX_CONTACTS];  /* slots in use, in order of addition */
    added_node nodes[MAX_CONTACTS]; /* nodes, indexed by slot */
} refinement;

/* An element of the refined mesh. */
typedef struct {
    int tet;                 /* nominal element that contains the leaf */
    int corners[4];
} leaf;

/* True if an added node lies on a face of its leaf. RT */
bool added_on_face(const added_node *node);

/* Position (m) of a leaf corner in the mesh with the first `active` contact nodes. RT */
vec3 refinement_position(const mesh *m, const refinement *r, int active, int corner);

/* Returns the leaf of nominal element `tet` that contains x, in the mesh with the first `active` contact nodes. RT */
leaf_point refinement_locate(const mesh *m, const refinement *r, int active, int tet, vec3 x);

/* Returns the nominal element that contains x when the nodes that the first `active` contact nodes move are at their new positions, and the weights of its
   corners. The search starts at `near`, the element that contains x in the nominal mesh. RT */
int refinement_element(const mesh *m, const refinement *r, int active, int near, vec3 x, double weights[4]);

/* Lists the leaves around nominal node `node`, which is a corner of element `start`. Returns their number, or -1 if there are more than MAX_PATCH_LEAVES. RT */
int refinement_around(const mesh *m, const refinement *r, int active, int node, int start, leaf leaves[MAX_PATCH_LEAVES]);

/* ---- for refinement.c and refined_mesh.c ---- */

/* Lists all leaves of nominal element `tet` in the mesh with the first `active` contact nodes. Returns their number. RT */
int leaves_of(const mesh *m, const refinement *r, int active, int tet, leaf leaves[MAX_LEAVES]);

/* Computes the positions (m) of a leaf's corners. RT */
void leaf_positions(const mesh *m, const refinement *r, int active, const int corners[4], vec3 positions[4]);

bool same_corners(const int a[4], const int b[4]);
bool leaf_has_corner(const leaf *l, int corner);

/* Returns the face closest to the point, judged by its weights, as the index of the opposite corner. RT */
int closest_face(const leaf_point *p);

#endif
