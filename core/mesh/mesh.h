/* The nominal mesh: linear tetrahedra with named regions and surfaces. Immutable after loading. */
#ifndef TROCAR_MESH_H
#define TROCAR_MESH_H

#include <stdbool.h>
#include <stdint.h>

#include "base/error.h"
#include "base/vec.h"

enum { MESH_NAME = 64, MESH_MAX_GROUPS = 32 };

/* A named set of nodes: a physical group of dimension 0 (points) to 3 (a region). */
typedef struct {
    char name[MESH_NAME];
    int dimension;
    int node_count;
    int *nodes;              /* [node_count], ascending */
} mesh_group;

/* A triangle of the outer surface. */
typedef struct {
    int nodes[3];            /* counter-clockwise as seen from outside */
    int tet, face;           /* tetrahedron behind the triangle, and number of its face (opposite vertex `face`) */
} boundary_face;

/* Node of the bounding-volume tree over the boundary faces. */
typedef struct {
    vec3 low, high;          /* m */
    int first, count;        /* leaf: its faces are bvh_order[first .. first+count); inner node: count is 0 and its children are first and first+1 */
} bvh_node;

typedef struct {
    int node_count, tet_count;
    vec3 *nodes;             /* [node_count]: nominal positions, m */
    int (*tets)[4];          /* [tet_count]: corner nodes; all volumes are positive */
    int (*neighbours)[4];    /* [tet_count]: neighbour at the face opposite vertex i; -1 on the boundary */
    int *region;             /* [tet_count]: index into groups of the region (dimension 3) that contains each tetrahedron */
    uint32_t (*face_groups)[4]; /* [tet_count]: bit g is set if face i is on the named surface groups[g] */
    int group_count;
    mesh_group groups[MESH_MAX_GROUPS];
    int boundary_count;
    boundary_face *boundary; /* [boundary_count], outer faces */
    bvh_node *bvh;           /* bounding-volume tree over `boundary` */
    int *bvh_order;          /* [boundary_count]: indices of the outer faces, in the order of the tree's leaves */
    double *node_size;       /* [node_count]: mean edge length (m) of regular tetrahedra with the same volumes as those around the node */
    bool *anatomical;        /* [node_count]: true if the node is on the outer surface, on an interface of regions, or on a named surface, line or point */
    trocar_error remarks;    /* changes made to the file's mesh, and suspected errors in the file; may be empty */
} mesh;

/* Reads a mesh whose unit of length is `unit` metres: MSH 2.2 and 4.1 or, if Gmsh is installed, any other format that Gmsh reads. Checks nodes, tetrahedra,
   orientation and conformity, and joins bodies whose faces match. BAD_INPUT with a message that names the file. */
trocar_status mesh_read_in(const char *path, double unit, mesh *m, trocar_error *why);

/* Loads a mesh file whose coordinates are in metres. */
static inline trocar_status mesh_read(const char *path, mesh *m, trocar_error *why) { return mesh_read_in(path, 1.0, m, why); }

/* Creates a mesh from arrays, which are copied. BAD_INPUT for indices out of range, for duplicate names, and for the faults that mesh_finish detects. */
trocar_status mesh_from_arrays(const trocar_mesh *given, mesh *m, trocar_error *why);
uint64_t mesh_hash(uint64_t h, const mesh *m); /* continues a hash (base/hash.h) with nodes, tetrahedra and their regions */
trocar_status mesh_arrays_check(const trocar_mesh *given, trocar_error *why); /* checks only indices and names */

/* Completes a mesh in which node_count, tet_count, nodes, tets, region and groups have been set: orients the tetrahedra, finds neighbours and the
   boundary, and builds the tree. `triangles`: triangles of named surfaces; `triangle_group`: their group indices. `name` is used in messages. Takes
   ownership of the arrays in `m`; they are released by `mesh_free`, also after a failure. */
trocar_status mesh_finish(mesh *m, int triangle_count, const int (*triangles)[3], const int *triangle_group,
                          const char *name, trocar_error *why);

void mesh_free(mesh *m);

/* Appends a sentence to the remarks. */
__attribute__((format(printf, 2, 3))) void mesh_remark(mesh *m, const char *format, ...);

/* Appends a remark if the size of the body or of its elements is implausible compared with that of the needle, which suggests a wrong unit. */
void mesh_compare_with_needle(mesh *m, double length, double diameter);

/* Returns the index of the group with this name and dimension (-1: any dimension), or -1. */
int mesh_find_group(const mesh *m, const char *name, int dimension);

/* Barycentric weights of x in tetrahedron `tet`. Their sum is 1; inside, all are >= 0. RT */
void mesh_barycentric(const mesh *m, int tet, vec3 x, double weights[4]);

/* Edge length (m) of the mesh in element `tet`: mean node_size of its corners. RT */
double mesh_edge_length(const mesh *m, int tet);

/* Barycentric weights of x in the tetrahedron with these corners. RT */
void tet_barycentric(const vec3 corners[4], vec3 x, double weights[4]);

/* Lists in `tets` the tetrahedra around a node of tetrahedron `start`. Returns their number, or -1 if there are more than `most`. RT */
int mesh_around(const mesh *m, int node, int start, int *tets, int most);

void mesh_corners(const mesh *m, int tet, vec3 corners[4]); /* m */
double mesh_volume(const mesh *m, int tet);                 /* m^3 */
vec3 mesh_point(const mesh *m, int tet, const double weights[4]);

/* Unit normal of a tetrahedron's face, directed toward the opposite corner. RT */
vec3 mesh_face_normal(const mesh *m, int tet, int face);

/* Gradients (1/m) of the four linear shape functions. Returns the volume. RT */
double tet_gradients(const vec3 corners[4], vec3 gradients[4]);

/* Finds the first point at which the segment from a to b enters the nominal body from outside. Takes O(log boundary_count) time. RT */
typedef struct {
    bool hit;
    double fraction;         /* 0 to 1 along the segment */
    int tet, face;
    vec3 point;              /* m */
} surface_hit;
surface_hit mesh_enter(const mesh *m, vec3 a, vec3 b);

/* Returns the tetrahedron that contains x, or -1. The search starts at tetrahedron `start` (-1: anywhere) and also works in non-convex meshes. */
int mesh_locate(const mesh *m, vec3 x, int start);

/* Returns the face through which the ray from x along d leaves tetrahedron `tet`, and the distance in units of d; -1 if d is zero. A point slightly
   outside a face is treated as being on the face. RT */
int mesh_exit(const mesh *m, int tet, vec3 x, vec3 d, double *distance);

/* Compares two node indices, for qsort and bsearch. */
static inline int compare_nodes(const void *a, const void *b) { return *(const int *)a - *(const int *)b; }

#endif
