/* What one contact node changes: the nodes of the elements that it splits or bends, and the change of their stiffness. */
#ifndef TROCAR_PATCH_H
#define TROCAR_PATCH_H

#include "refinement/refinement.h"

enum {
    MAX_RANK = 3 * MAX_PATCH,
    ALL_RANKS = 3 * (MAX_MOVED_PATCHES + 6 * MAX_CONTACTS), /* dofs touched by all changes together; an addition touches six nodes */
};

typedef struct {
    int count;                   /* nodes touched that are not fixed */
    int nodes[MAX_PATCH];        /* nominal node, or added node -1 - slot; the contact node itself, if it is an added one, is last */
    double change[MAX_RANK][MAX_RANK]; /* stiffness after minus before, N/m: [3 i + a][3 k + b], symmetric */
} patch;

/* The change that the contact node in place `position` of the order brings to the mesh with all nodes before it. `position` may be r->count:
   a node that is in order[count] and not counted yet. Its sum with the stiffness of that mesh is
   the stiffness of the next one. Averaged strains stay those of the nominal mesh, which is right for added nodes only:
   nodes move with STRAIN_BY_ELEMENT. */
void patch_create(const tissue *t, const refinement *r, int position, patch *p);

/* Of the same change, only the columns of the added node itself: where it ends up coupled, and how stiff it is. */
enum { SPLIT_NODES = 5 };
typedef struct {
    int count;
    int nodes[SPLIT_NODES];      /* beside it, not fixed, coded as in patch */
    mat3 beside[SPLIT_NODES];    /* N/m: rows of that node, columns of the added one */
    mat3 own;                    /* N/m */
} split_columns;
void patch_own_columns(const tissue *t, const refinement *r, int position, split_columns *s);

#endif
