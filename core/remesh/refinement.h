/* The refined part of the mesh: contact nodes, each added inside an element, added on a face, or one of the mesh's own that was
   moved there. Adding moves no node, so the old finite-element space stays inside the new one; moving does not keep it. See
   README.md, "Node addition is a nested refinement" and "Remeshing methods". */
#ifndef TROCAR_REFINEMENT_H
#define TROCAR_REFINEMENT_H

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

/* Adds a node at x in `tet`, shifted inside where x is nearly on a face of its leaf. Returns its slot, or -1 when full. RT */
int refinement_add(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id);

/* Adds a node on the face of its leaf that x in `tet` is closest to, shifted inside where x is nearly on an edge. RT */
int refinement_add_on_face(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id);

/* Moves the closest corner of that face to x. Returns the slot, or -1 where it must stay: an anatomical, fixed, added or
   moved node, one whose elements would be inverted or too flat, one with too many neighbours, or the list is full. RT */
int refinement_move(const tissue *t, refinement *r, int tet, vec3 x, uint64_t id);

/* The node `id` in `order`, or -1. RT */
int refinement_find(const refinement *r, uint64_t id);

/* Removes the node `id`; the others keep their slots and positions. Leaves that it had split are whole again, so that later nodes in them
   split other leaves than before: the mesh is the one that the nodes left over make when they are added in the same order. Returns the
   slot that is free now, or -1: there is no such node, or it, or one added after it, was moved, and it is not the last one. RT */
int refinement_remove(const mesh *m, refinement *r, uint64_t id);

/* Does a leaf that this node splits have a corner in one of these slots (bit i: slot i)? RT */
bool refinement_hangs_on(const added_node *node, uint64_t slots);

/* One more than the highest slot in use. RT */
int refinement_span(const refinement *r);

/* The first `count` nodes in order, numbered anew: slot i is the i-th. */
void refinement_compact(const refinement *r, int count, refinement *out);

/* The refined mesh written out: nominal nodes, then the contact nodes (no element has the entry of a moved one); `parent` is
   each tet's nominal element. The contact nodes are in slots without gaps (refinement_compact). */
typedef struct {
    int node_count, tet_count;
    vec3 *nodes;
    int (*tets)[4];
    int *parent;
} refined_mesh;
trocar_status refined_mesh_create(const mesh *m, const refinement *r, refined_mesh *out, report *why);
void refined_mesh_free(refined_mesh *out);

#endif
