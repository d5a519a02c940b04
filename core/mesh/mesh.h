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

/* A triangle of the outer surface. */
typedef struct {
    int nodes[3];            /* counter-clockwise as seen from outside */
    int tet, face;           /* tetrahedron behind the triangle, and its face (opposite vertex `face`) */
} boundary_face;

/* Node of the bounding-volume tree over the boundary faces. */
typedef struct {
    vec3 low, high;          /* m */
    int first, count;        /* leaf: faces order[first .. first+count); inner node: count 0, children first, first+1 */
} bvh_node;

typedef struct {
    int node_count, tet_count;
    vec3 *nodes;             /* node_count: nominal positions, m */
    int (*tets)[4];          /* tet_count: nodes, positive volume */
    int (*neighbours)[4];    /* tet_count: neighbour at the face opposite vertex i, -1 at the boundary */
    int *region;             /* tet_count: index into groups of the containing region (dimension 3) */
    uint32_t (*face_groups)[4]; /* tet_count: bit g is set if face i is on the named surface groups[g] */
    int group_count;
    mesh_group groups[MESH_MAX_GROUPS];
    int boundary_count;
    boundary_face *boundary; /* boundary_count */
    bvh_node *bvh;           /* tree over `boundary` */
    int *bvh_order;          /* boundary_count */
    double *node_size;       /* node_count: mean edge length of equivalent regular tets around the node, m */
    bool *anatomical;        /* node_count: on the outer surface, an interface of regions, or a named surface, line or point */
    report remarks;          /* changes made to the file's mesh, and suspected errors in the file; may be empty */
} mesh;

/* Reads MSH 2.2 and 4.1, and by way of Gmsh, if it is installed, any other format that Gmsh reads, with coordinates in `unit` (m); checks nodes, tets,
   orientation and conformity, and joins bodies whose faces match. BAD_INPUT with a message that names the file. */
trocar_status mesh_read_in(const char *path, double unit, mesh *m, report *why);

/* Loads a mesh file whose coordinates are in metres. */
static inline trocar_status mesh_read(const char *path, mesh *m, report *why) { return mesh_read_in(path, 1.0, m, why); }

/* Creates a mesh from arrays, which are copied. BAD_INPUT for indices out of range, for duplicate names, and as in mesh_finish. */
trocar_status mesh_from_arrays(const trocar_mesh *given, mesh *m, report *why);
trocar_status mesh_arrays_check(const trocar_mesh *given, report *why); /* only checks indices and names */

/* Completes a mesh that has node_count, tet_count, nodes, tets, region and groups: orients the tets, finds neighbours and the boundary, and builds
   the tree. `triangles`: triangles of named surfaces; `triangle_group`: their group indices. `name` is used in messages. Takes ownership of the
   arrays in `m`; release them with `mesh_free`, also after a failure. */
trocar_status mesh_finish(mesh *m, int triangle_count, const int (*triangles)[3], const int *triangle_group,
                          const char *name, report *why);

void mesh_free(mesh *m);

/* Appends a sentence to the remarks. */
__attribute__((format(printf, 2, 3))) void mesh_remark(mesh *m, const char *format, ...);

/* Appends a remark if the body or its elements are implausibly large or small compared with the needle, which suggests a wrong unit. */
void mesh_compare_with_needle(mesh *m, double length, double diameter);

/* Index of the group with this name and dimension (-1: any), or -1. */
int mesh_find_group(const mesh *m, const char *name, int dimension);

/* Barycentric weights of x in tetrahedron t: their sum is 1, and they are all >= 0 inside. RT */
void mesh_barycentric(const mesh *m, int tet, vec3 x, double weights[4]);

/* Edge length of the mesh in element `tet`, m: mean of node_size. RT */
double mesh_edge_length(const mesh *m, int tet);

/* Barycentric weights of x in a tetrahedron given by its corners. RT */
void tet_barycentric(const vec3 corners[4], vec3 x, double weights[4]);

/* Finds the tetrahedra around a node of tet `start`. Returns their number, or -1 if there are more than `most`. RT */
int mesh_around(const mesh *m, int node, int start, int *tets, int most);

void mesh_corners(const mesh *m, int tet, vec3 corners[4]); /* m */
double mesh_volume(const mesh *m, int tet);                 /* m^3 */
vec3 mesh_point(const mesh *m, int tet, const double weights[4]);

/* Unit normal of a tet's face, toward the opposite corner. RT */
vec3 mesh_face_normal(const mesh *m, int tet, int face);

/* Gradients of the four linear shape functions, 1/m. Returns the volume. RT */
double tet_gradients(const vec3 corners[4], vec3 gradients[4]);

/* First point at which the segment from a to b enters the nominal body from outside. Time O(log boundary). RT */
typedef struct {
    bool hit;
    double fraction;         /* 0..1 along the segment */
    int tet, face;
    vec3 point;              /* m */
} surface_hit;
surface_hit mesh_enter(const mesh *m, vec3 a, vec3 b);

/* The tetrahedron that contains x, or -1. The search starts at tet `start` (-1: any) and also works in non-convex meshes. */
int mesh_locate(const mesh *m, vec3 x, int start);

/* Face through which the ray from x in tet `tet` along d leaves it, and the distance in units of d; -1 if d is zero. A point slightly outside a face is
   treated as on the face. RT */
int mesh_exit(const mesh *m, int tet, vec3 x, vec3 d, double *distance);

/* Compares node numbers, for qsort and bsearch. */
static inline int compare_nodes(const void *a, const void *b) { return *(const int *)a - *(const int *)b; }

#endif
