/* The patch of one contact node: the nodes of the elements that it splits or bends, and the resulting change in their stiffness. */
#ifndef TROCAR_PATCH_H
#define TROCAR_PATCH_H

#include "refinement/refinement.h"

enum {
    MAX_RANK = 3 * MAX_PATCH,
    ALL_RANKS = 3 * (MAX_MOVED_PATCHES + 6 * MAX_CONTACTS), /* number of dofs touched by all changes together; one addition touches six nodes */
};

typedef struct {
    int count;                   /* number of touched nodes that are not fixed */
    int nodes[MAX_PATCH];        /* nominal node, or -1 - slot for an added node; if the contact node itself is an added node, it is the last one */
    double change[MAX_RANK][MAX_RANK]; /* stiffness after minus before, N/m: [3 i + a][3 k + b], symmetric */
} patch;

/* Computes the change in stiffness when the contact node order[position] is added to the mesh with all earlier nodes. `position` may be r->count, for a node
   in order[count] that is not counted yet. Averaged strains remain those of the nominal mesh; this is valid only for added nodes, so moved nodes require
   STRAIN_BY_ELEMENT. Membranes do not change, because nodes are added inside elements; tests that add nodes on faces of the nominal mesh or move its nodes
   have no membranes. */
void patch_create(const tissue *t, const refinement *r, int position, patch *p);

/* The part of an added node's patch that belongs to the node itself: its coupling and its own stiffness. */
enum { SPLIT_NODES = 5 };
typedef struct {
    int count;
    int nodes[SPLIT_NODES];      /* adjacent nodes that are not fixed, coded as in `patch` */
    mat3 beside[SPLIT_NODES];    /* N/m: rows of the adjacent node and columns of the added one */
    mat3 own;                    /* N/m */
} split_columns;
void patch_own_columns(const tissue *t, const refinement *r, int position, split_columns *s);

#endif
