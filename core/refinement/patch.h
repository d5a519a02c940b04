/* A contact node's patch: the nodes of the elements that it splits or deforms, and how these elements' stiffness changes as a result. */
#ifndef TROCAR_PATCH_H
#define TROCAR_PATCH_H

#include "refinement/refinement.h"

enum {
    MAX_RANK = 3 * MAX_PATCH,
    ALL_RANKS = 3 * (MAX_MOVED_PATCHES + 6 * MAX_CONTACTS), /* number of degrees of freedom touched by all changes together; an added node touches up to six
                                                               nodes */
};

typedef struct {
    int count;                   /* number of touched nodes that are not fixed */
    int nodes[MAX_PATCH];        /* nominal node, or -1 - slot for an added node. If the contact node is itself an added node, it comes last */
    double change[MAX_RANK][MAX_RANK]; /* N/m, stiffness after minus before: [3 i + a][3 k + b], symmetric */
} patch;

/* Computes how the stiffness changes when the contact node order[position] is added to the mesh with all earlier ones. `position` may be r->count, for a node
   in order[count] that is not counted yet. Strain averages are still those of the nominal mesh. This is valid only for added nodes, so moved nodes require
   STRAIN_BY_ELEMENT. Membranes are ignored, because nodes are normally added inside elements; the tests that add nodes on faces of the nominal mesh or move its
   nodes use no membranes. */
void patch_create(const tissue *t, const refinement *r, int position, patch *p);

/* The part of an added node's patch that involves the node itself: its own stiffness and its coupling to adjacent nodes. */
enum { SPLIT_NODES = 5 };
typedef struct {
    int count;
    int nodes[SPLIT_NODES];      /* adjacent nodes that are not fixed, encoded as in `patch` */
    mat3 beside[SPLIT_NODES];    /* N/m, rows for the adjacent node, columns for the added node */
    mat3 own;                    /* N/m */
} split_columns;
void patch_own_columns(const tissue *t, const refinement *r, int position, split_columns *s);

#endif
