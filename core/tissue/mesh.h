/* The nominal mesh: linear tetrahedra with named regions and surfaces, constant after load. */
#ifndef TROCAR_MESH_H
#define TROCAR_MESH_H

#include <stdbool.h>
#include <stdint.h>

#include "base/report.h"
#include "base/vec.h"

enum { MESH_NAME = 64, MESH_MAX_GROUPS = 32 };

/* A named set of nodes: a physical group of dimension 0 (points) to 3 (a region). */
typedef struct {
    char name[MESH_NAME];
    int dimension;
    int node_count;
    int *nodes;              /* node_count, ascending */
} mesh_group;

/* One triangle of the outer surface. */
typedef struct {
    int nodes[3];            /* seen from outside: counter-clockwise */
    int tet, face;           /* the tetrahedron behind it, and its face (opposite vertex `face`) */
} boundary_face;

/* Node of the bounding-volume tree over the boundary faces. */
typedef struct {
    vec3 low, high;          /* m */
    int first, count;        /* leaf: faces order[first .. first+count); inner: count 0, children first, first+1 */
} bvh_node;

typedef struct {
    int node_count, tet_count;
    vec3 *nodes;             /* node_count: nominal position, m */
    int (*tets)[4];          /* tet_count: nodes, positive volume */
    int (*neighbours)[4];    /* tet_count: tet across the face opposite vertex i, or -1 outside */
    int *region;             /* tet_count: index into groups of the containing region (dimension 3) */
    uint32_t (*face_groups)[4]; /* tet_count: bit g set where face i lies on the named surface groups[g] */
    int group_count;
    mesh_group groups[MESH_MAX_GROUPS];
    int boundary_count;
    boundary_face *boundary; /* boundary_count */
    bvh_node *bvh;           /* tree over `boundary` */
    int *bvh_order;          /* boundary_count */
    double *node_size;       /* node_count: mean edge of the ideal tets around the node, m (continuous over faces) */
    bool *anatomical;        /* node_count: on the outer surface, between regions, or of a named surface, line or point */
    report remarks;          /* what was done to the file's mesh, or looks wrong in it; empty: nothing */
} mesh;

/* Reads any format that Gmsh reads (the only function that knows Gmsh), with coordinates in `unit` (m); checks nodes, tets,
   orientation and conformity, and joins bodies whose faces match. BAD_INPUT with a message that names the file. Not thread-safe:
   Gmsh is one global. */
trocar_status mesh_read_in(const char *path, double unit, mesh *m, report *why);

/* The same in metres. */
static inline trocar_status mesh_read(const char *path, mesh *m, report *why) { return mesh_read_in(path, 1.0, m, why); }

/* The same from arrays, which are copied. BAD_INPUT for indices out of range, names that repeat, and as in mesh_finish. */
trocar_status mesh_from_arrays(const trocar_mesh *given, mesh *m, report *why);
trocar_status mesh_arrays_check(const trocar_mesh *given, report *why); /* its first part: indices and names are there */

/* Completes a mesh whose node_count, tet_count, nodes, tets, region and groups are given: orients the tets,
   finds neighbours and the boundary, builds the tree. `triangles` are the named surface triangles (group index each).
   `name` is for messages. Takes ownership of the arrays in `m`; on failure `mesh_free` releases them. */
trocar_status mesh_finish(mesh *m, int triangle_count, const int (*triangles)[3], const int *triangle_group,
                          const char *name, report *why);

void mesh_free(mesh *m);

/* Adds a sentence to the remarks. */
__attribute__((format(printf, 2, 3))) void mesh_remark(mesh *m, const char *format, ...);

/* Adds to the remarks if the body or its elements are out of all proportion to a needle, as when the unit is wrong. */
void mesh_compare_with_needle(mesh *m, double length, double diameter);

/* Index of the group of this name and dimension (any if -1), or -1. */
int mesh_find_group(const mesh *m, const char *name, int dimension);

/* Barycentric weights of x in tet t: they sum to 1, all >= 0 inside. RT */
void mesh_barycentric(const mesh *m, int tet, vec3 x, double weights[4]);

/* The same in any tetrahedron. RT */
void tet_barycentric(const vec3 corners[4], vec3 x, double weights[4]);

/* The tetrahedra around a node of tet `start`, found from neighbour to neighbour. Returns how many, or -1 if more than `most`. RT */
int mesh_around(const mesh *m, int node, int start, int *tets, int most);

double mesh_volume(const mesh *m, int tet);                 /* m^3 */
vec3 mesh_point(const mesh *m, int tet, const double weights[4]);

/* Unit normal of a tet's face, toward the opposite corner. RT */
vec3 mesh_face_normal(const mesh *m, int tet, int face);

/* Gradient of the four linear shape functions, 1/m. Returns the volume. RT */
double tet_gradients(const vec3 corners[4], vec3 gradients[4]);

/* Where the segment from a to b first enters the nominal body from outside. Time O(log boundary). RT */
typedef struct {
    bool hit;
    double fraction;         /* 0..1 along the segment */
    int tet, face;
    vec3 point;              /* m */
} surface_hit;
surface_hit mesh_enter(const mesh *m, vec3 a, vec3 b);

/* The tetrahedron that contains x, or -1: a walk from `start` (any tet if -1), safe on every mesh. */
int mesh_locate(const mesh *m, vec3 x, int start);

/* Leaving tet `t` from inside point x along direction d: the face first reached (>= 0) and the distance in units of d;
   -1 if d is zero. A start slightly outside a face counts as on it. RT */
int mesh_exit(const mesh *m, int tet, vec3 x, vec3 d, double *distance);

#endif
