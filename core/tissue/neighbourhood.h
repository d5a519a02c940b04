/* The elements around a point of a line, in the line's frame, and their stiffness for a shear modulus of 1: on them, what the mesh
   resolves of the line's field is measured. For resolved_radius.c. */
#ifndef TROCAR_NEIGHBOURHOOD_H
#define TROCAR_NEIGHBOURHOOD_H

#include "tissue/tissue.h"

enum { AROUND_NODES = 256, AROUND_TETS = 1200, AROUND_DOFS = 3 * AROUND_NODES };

typedef struct {
    int tet;
    double from, to;         /* m along the line */
} chord;

/* All positions in the frame of the line: z along it, its point is the origin. */
typedef struct {
    const tissue *tissue;
    int *local;              /* node_count of the mesh: number in the neighbourhood, or -1 */
    bool *taken;             /* tet_count */
    int node_count, nodes[AROUND_NODES], tet_count, tets[AROUND_TETS];
    vec3 position[AROUND_NODES];
    bool cut[AROUND_NODES];  /* on the boundary to the rest of the mesh */
    mat3 frame;              /* columns: the line's frame */
    vec3 origin;
    double size;             /* m, edge length of the mesh at the point */
    double poisson_ratio;    /* of the point's element, taken for all */
    int chord_count;
    chord chords[AROUND_TETS]; /* the line's way through the elements, in order */
    double stiffness[AROUND_DOFS * AROUND_DOFS]; /* full */
} neighbourhood;

/* NO_MEMORY. `t` must outlive it. */
trocar_status neighbourhood_create(const tissue *t, neighbourhood *n, report *why);
void neighbourhood_free(neighbourhood *n);

/* How far it reaches: from the line, and along it in both directions. */
typedef struct {
    double radius, half_length; /* in edge lengths of the mesh there */
    double least;               /* m, of half the length */
} patch_reach;

/* Collects the elements with a node within reach of `x` of element `tet` and the line through it, and their stiffness. As many as there
   is room for. Allocates nothing. */
void neighbourhood_take(neighbourhood *n, int tet, vec3 x, vec3 direction, patch_reach reach);

/* A face of the outer surface where nothing holds it. Where it is held, the body ends no more than it does at the neighbourhood's other
   borders: how far away a support is the nominal mesh knows. */
bool neighbourhood_free_face(const neighbourhood *n, int tet, int face);

/* The line's, unit vector in the mesh. */
vec3 neighbourhood_direction(const neighbourhood *n);

#endif
