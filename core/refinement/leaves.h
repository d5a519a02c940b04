/* The refined mesh: contact nodes, and the leaves, parts of nominal elements, into which they split the mesh. refinement.h adds and removes
   nodes. */
#ifndef TROCAR_LEAVES_H
#define TROCAR_LEAVES_H

#include "tissue/resolved_radius.h"

enum {
    MAX_CONTACTS = 64,       /* contact nodes alive at once */
    MAX_PATCH = 48,          /* nodes that one change of the mesh touches */
    MAX_PATCH_LEAVES = 2 * (MAX_PATCH - 3), /* around a moved node: Euler's formula on the sphere of its neighbours */
    MAX_MOVED_PATCHES = 1024,   /* nodes touched by all moves together */
    MAX_LEAVES = 1 + 3 * MAX_CONTACTS, /* of one nominal element */
};

/* A point of the refined mesh: leaf corners (nominal node >= 0, added node -1 - slot) and barycentric weights. */
typedef struct {
    int corners[4];
    double weights[4];
} leaf_point;

/* A contact node of the needle. */
typedef struct {
    uint64_t id;             /* never used twice in one insertion state */
    int tet;                 /* nominal element that contains it */
    vec3 position;           /* nominal, m */
    int moved;               /* nominal node that was moved here, or -1: a node of its own, which splits its leaf */
    leaf_point at;           /* in four or, where the weight of the corner opposite is 0: on a face, in three */
    int across_tet;          /* on a face: nominal element of the leaf on the other side, -1 where there is none */
    leaf_point across;       /* that leaf, split in three as well */
    int touched;             /* nodes of the patch of a moved node, with itself */
    line_in_tet line;        /* on which to measure what the mesh resolves at the node: the needle's way past it. Set by
                                whoever adds it; no direction: it is not measured */
} added_node;

/* The contact nodes. Each keeps its slot, and the id that identifies it, from its addition to its removal; a new one takes the lowest
   free slot. Each splits or bends the mesh with the nodes before it in `order`: functions that count "the first `active`" nodes mean
   those at the front of `order`. */
typedef struct {
    int count;
    int order[MAX_CONTACTS];  /* slots in use, in order of addition */
    added_node nodes[MAX_CONTACTS]; /* by slot */
} refinement;

/* An element of the refined mesh. */
typedef struct {
    int tet;                 /* nominal element that it is a part of */
    int corners[4];
} leaf;

/* Of an added node: it lies on a face of its leaf. RT */
bool added_on_face(const added_node *node);

/* Where a leaf corner is, counting only the first `active` contact nodes, m. RT */
vec3 refinement_position(const mesh *m, const refinement *r, int active, int corner);

/* The leaf of nominal element `tet` that contains x, counting only the first `active` contact nodes. RT */
leaf_point refinement_locate(const mesh *m, const refinement *r, int active, int tet, vec3 x);

/* The nominal element, its moved corners (of the first `active` contact nodes) where they are now, that contains x, and the weights of its
   corners there: walking from `near`, nominally around x. RT */
int refinement_element(const mesh *m, const refinement *r, int active, int near, vec3 x, double weights[4]);

/* The leaves that have nominal node `node` (of element `start`) as a corner, or -1 if there are more than MAX_PATCH_LEAVES. RT */
int refinement_around(const mesh *m, const refinement *r, int active, int node, int start, leaf leaves[MAX_PATCH_LEAVES]);

/* ---- for refinement.c and refined_mesh.c ---- */

/* All leaves of nominal element `tet`, counting only the first `active` contact nodes. Returns their number. RT */
int leaves_of(const mesh *m, const refinement *r, int active, int tet, leaf leaves[MAX_LEAVES]);

/* Positions of a leaf's corners, m. RT */
void leaf_positions(const mesh *m, const refinement *r, int active, const int corners[4], vec3 positions[4]);

bool same_corners(const int a[4], const int b[4]);
bool leaf_has_corner(const leaf *l, int corner);

/* The face that the point is closest to by its weights: the corner opposite it. RT */
int closest_face(const leaf_point *p);

#endif
