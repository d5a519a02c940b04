/* The refined mesh. Contact nodes split the nominal elements into smaller ones, the leaves. Nodes are added and removed in refinement.h. */
#ifndef TROCAR_LEAVES_H
#define TROCAR_LEAVES_H

#include "tissue/resolved_radius.h"

enum {
    MAX_CONTACTS = 64,       /* maximum number of contact nodes at the same time */
    MAX_PATCH = 48,          /* maximum number of nodes touched by a single change to the mesh */
    MAX_PATCH_LEAVES = 2 * (MAX_PATCH - 3), /* maximum number of leaves around a moved node, from Euler's formula for the sphere formed by its neighbours */
    MAX_MOVED_PATCHES = 1024,   /* maximum number of nodes touched by all moves together */
    MAX_LEAVES = 1 + 3 * MAX_CONTACTS, /* maximum number of leaves in one nominal element */
};

/* A point of the refined mesh, given by its leaf and its barycentric weights there. `corners`: the nominal node (>= 0) or, for an added node, -1 - slot. */
typedef struct {
    int corners[4];
    double weights[4];
} leaf_point;

/* A contact node of the needle. */
typedef struct {
    uint64_t id;             /* unique within one insertion state */
    int tet;                 /* nominal element that contains it */
    vec3 position;           /* m, nominal position */
    int moved;               /* the nominal node that was moved here; -1 if this is an added node, which splits its leaf */
    leaf_point at;           /* the leaf that the node splits into four. If one weight is 0, the node is on the face opposite that corner and splits the leaf
                                into three */
    int across_tet;          /* if the node is on a face: nominal element of the leaf on the other side; -1 if none */
    leaf_point across;       /* the leaf on the other side, which is split into three as well */
    int touched;             /* number of nodes in the patch of a moved node, including the node itself */
    line_in_tet line;        /* the needle's path past the node, along which the mesh's resolution is measured. Set by the caller; if its direction is zero,
                                nothing is measured */
} added_node;

/* The contact nodes. A node keeps its slot and id until it is removed, and a new one takes the lowest free slot. Each node splits or deforms the mesh made by
   the nodes before it in `order`. In the functions below, "the first `active` nodes" means the first entries of `order`. */
typedef struct {
    int count;
    int order[MAX_CONTACTS];  /* slots in use, in order of addition */
    added_node nodes[MAX_CONTACTS]; /* nodes, indexed by slot */
} refinement;

/* An element of the refined mesh. */
typedef struct {
    int tet;                 /* the nominal element it is part of */
    int corners[4];
} leaf;

/* Returns whether an added node lies on a face of its leaf. RT */
bool added_on_face(const added_node *node);

/* Returns the position (m) of a leaf corner in the mesh with the first `active` contact nodes. RT */
vec3 refinement_position(const mesh *m, const refinement *r, int active, int corner);

/* Returns the leaf of nominal element `tet` that contains x, in the mesh with the first `active` contact nodes. RT */
leaf_point refinement_locate(const mesh *m, const refinement *r, int active, int tet, vec3 x);

/* Returns the nominal element that contains x, allowing for the nominal nodes moved by the first `active` contact nodes, and sets `weights` to the barycentric
   weights of x in it. The search starts at `near`, the element that contains x in the nominal mesh. RT */
int refinement_element(const mesh *m, const refinement *r, int active, int near, vec3 x, double weights[4]);

/* Lists the leaves around nominal node `node`, a corner of element `start`. Returns how many there are, or -1 if more than MAX_PATCH_LEAVES. RT */
int refinement_around(const mesh *m, const refinement *r, int active, int node, int start, leaf leaves[MAX_PATCH_LEAVES]);

/* ---- for refinement.c and refined_mesh.c ---- */

/* Lists all leaves of nominal element `tet` in the mesh with the first `active` contact nodes. Returns how many there are. RT */
int leaves_of(const mesh *m, const refinement *r, int active, int tet, leaf leaves[MAX_LEAVES]);

/* Computes the positions (m) of a leaf's corners. RT */
void leaf_positions(const mesh *m, const refinement *r, int active, const int corners[4], vec3 positions[4]);

bool same_corners(const int a[4], const int b[4]);
bool leaf_has_corner(const leaf *l, int corner);

/* Returns the face the point is closest to, judging by its weights, as the index of the opposite corner. RT */
int closest_face(const leaf_point *p);

#endif
