/* The elements around a point on a line, in the line's frame, and their stiffness for a shear modulus of 1. With them, resolved_radius.c measures how close to
   the line the mesh still resolves the line's field. */
#ifndef TROCAR_NEIGHBOURHOOD_H
#define TROCAR_NEIGHBOURHOOD_H

#include "tissue/tissue.h"

enum { AROUND_NODES = 256, AROUND_TETS = 1200, AROUND_DOFS = 3 * AROUND_NODES };

typedef struct {
    int tet;
    double from, to;         /* m, position of the chord's ends along the line */
} chord;

typedef struct { int tet, face; } tet_face;

/* All positions are in the line's frame: z along the line, the origin at the given point. */
typedef struct {
    const tissue *tissue;
    int *local;              /* for each node of the mesh: its number in the neighbourhood, or -1 */
    bool *taken;             /* for each tetrahedron of the mesh: whether it is in the neighbourhood */
    int node_count, nodes[AROUND_NODES], tet_count, tets[AROUND_TETS]; /* where the tissue slides, the nodes at one place count as one (mesh_place) */
    vec3 position[AROUND_NODES];
    bool cut[AROUND_NODES];  /* whether the node is on the boundary with the rest of the mesh */
    int free_count;
    tet_face free[4 * AROUND_TETS]; /* the elements' faces on the outer surface, except fixed ones. A fixed face counts as a boundary with the rest of the mesh,
                                       because the nominal mesh already includes the support */
    mat3 frame;              /* its columns are the axes of the line's frame */
    vec3 origin;
    double size;             /* m, edge length of the mesh at the point */
    double poisson_ratio;    /* Poisson's ratio of the element that contains the point; used for all elements */
    int chord_count;
    chord chords[AROUND_TETS]; /* the line's path through the elements, in order */
    double stiffness[AROUND_DOFS * AROUND_DOFS]; /* stiffness matrix of the nodes; both triangles are filled */
} neighbourhood;

/* Allocates the work arrays. `t` must outlive the neighbourhood. NO_MEMORY. */
trocar_status neighbourhood_create(const tissue *t, neighbourhood *n, trocar_error *why);
void neighbourhood_free(neighbourhood *n);

/* Extent of the neighbourhood across the line, and along it in both directions. */
typedef struct {
    double radius, half_length; /* in edge lengths of the mesh at the point */
    double least;               /* m, the half length is at least this */
} patch_reach;

/* Collects the elements within `reach` of `x` (in element `tet`), measured along and across the line through x, as far as there is room. Computes their
   stiffness. Does not allocate memory. */
void neighbourhood_take(neighbourhood *n, int tet, vec3 x, vec3 direction, patch_reach reach);

/* Returns the line's direction as a unit vector in the mesh's coordinates. */
vec3 neighbourhood_direction(const neighbourhood *n);

#endif
