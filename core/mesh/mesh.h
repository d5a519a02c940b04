/* The nominal mesh: linear tetrahedra with named regions and surfaces. Immutable after loading. */
#ifndef TROCAR_MESH_H
#define TROCAR_MESH_H

#include <stdbool.h>
#include <stdint.h>

#include "base/error.h"
#include "base/vec.h"

enum { MESH_NAME = 64, MESH_MAX_GROUPS = 32 };

/* A named set of nodes: a physical group with dimension 0 (points) to 3 (a region). */
typedef struct {
    char name[MESH_NAME];
    int dimension;
    int node_count;
    int *nodes;              /* [node_count], ascending */
} mesh_group;

/* A triangle of the outer surface. */
typedef struct {
    int nodes[3];            /* counter-clockwise as seen from outside */
    int tet, face;           /* the tetrahedron behind the triangle, and which of its faces this is (face i is opposite vertex i) */
} boundary_face;

/* A node of the bounding-volume tree over the boundary faces. */
typedef struct {
    vec3 low, high;          /* m */
    int first, count;        /* leaf: its faces are bvh_order[first .. first+count); inner node: count is 0 and its children are first and first+1 */
} bvh_node;

/* Two nodes at the same place, on the two sides of a surface on which the tissue slides. */
typedef struct {
    int nodes[2];
    int group;               /* index of the surface in `groups` */
    vec3 normal;             /* unit normal of the surface, from the side of nodes[0] to that of nodes[1] */
    double area;             /* m^2, a third of the area of the adjacent faces */
} node_pair;

typedef struct {
    int node_count, tet_count;
    vec3 *nodes;             /* [node_count]: nominal positions, m */
    int (*tets)[4];          /* [tet_count]: corner nodes; all volumes are positive */
    int (*neighbours)[4];    /* [tet_count]: neighbour at the face opposite vertex i; -1 on the boundary. Where the tissue slides, the two share no
                                nodes, except at the rim of the surface */
    uint8_t *slides;         /* [tet_count]: bit i is set if the tissue slides along face i; NULL if it slides nowhere */
    int *region;             /* [tet_count]: index in `groups` of the region (dimension 3) that contains each tetrahedron */
    uint32_t (*face_groups)[4]; /* [tet_count]: bit g is set if face i is on the named surface groups[g] */
    int group_count;
    mesh_group groups[MESH_MAX_GROUPS];
    int boundary_count;
    boundary_face *boundary; /* [boundary_count], outer faces */
    bvh_node *bvh;           /* bounding-volume tree over `boundary` */
    int *bvh_order;          /* [boundary_count]: indices of the outer faces, in the order of the tree's leaves */
    int *original;           /* [node_count]: the node of which each node is a copy, or the node itself; NULL if the tissue slides nowhere */
    int pair_count;
    node_pair *pairs;        /* [pair_count] */
    double *node_size;       /* [node_count]: mean edge length (m) of regular tetrahedra with the same volumes as those around the node */
    bool *anatomical;        /* [node_count]: true if the node is on the outer surface, on an interface between regions, or on a named surface, line or point */
    trocar_error remarks;    /* repairs made to the mesh, and suspected errors in it; may be empty */
} mesh;

/* Reads a mesh whose unit of length is `unit` metres, in MSH 2.2 or 4.1 or, if Gmsh is installed, any other format that Gmsh reads. Checks nodes, tetrahedra,
   orientation and conformity, and joins bodies whose faces match. BAD_INPUT; the message names the file. */
trocar_status mesh_read_in(const char *path, double unit, mesh *m, trocar_error *why);

/* Reads a mesh whose coordinates are in metres. */
static inline trocar_status mesh_read(const char *path, mesh *m, trocar_error *why) { return mesh_read_in(path, 1.0, m, why); }

/* Creates a mesh from a copy of these arrays. BAD_INPUT for indices out of range, duplicate names, and any fault that mesh_finish detects. */
trocar_status mesh_from_arrays(const trocar_mesh *given, mesh *m, trocar_error *why);
uint64_t mesh_hash(uint64_t h, const mesh *m); /* continues a hash (base/hash.h) with nodes, tetrahedra and their regions */
trocar_status mesh_arrays_check(const trocar_mesh *given, trocar_error *why); /* checks only indices and names */

/* Completes a mesh in which node_count, tet_count, nodes, tets, region and groups have been set: orients the tetrahedra, finds neighbours and the boundary,
   and builds the tree. `triangles` are the triangles of named surfaces, and `triangle_group` their group indices. `name` is used in messages. Takes ownership
   of the arrays in `m`: release them with mesh_free, even after a failure. */
trocar_status mesh_finish(mesh *m, int triangle_count, const int (*triangles)[3], const int *triangle_group,
                          const char *name, trocar_error *why);

void mesh_free(mesh *m);

/* Appends a sentence to the remarks. */
__attribute__((format(printf, 2, 3))) void mesh_remark(mesh *m, const char *format, ...);

/* Appends a remark if the body or its elements are implausibly large or small compared with the needle, which suggests a wrong unit. */
void mesh_compare_with_needle(mesh *m, double length, double diameter);

/* Replaces a group's nodes by those marked in members[node_count]. Returns false, and changes nothing, if out of memory. */
bool mesh_set_group(mesh_group *group, int node_count, const bool *members);

/* Returns the index of the group with this name and dimension (-1: any dimension), or -1. */
int mesh_find_group(const mesh *m, const char *name, int dimension);

/* Returns the node that stands for all nodes at this node's place; where the tissue slides, there are several. RT */
static inline int mesh_place(const mesh *m, int node) { return m->original ? m->original[node] : node; }

/* Returns whether the tissue slides along this face. RT */
static inline bool mesh_slides(const mesh *m, int tet, int face) { return m->slides && m->slides[tet] >> face & 1; }

/* Returns the neighbour at this face, or -1 if there is none or the tissue slides along the face. RT */
static inline int mesh_bonded(const mesh *m, int tet, int face) { return mesh_slides(m, tet, face) ? -1 : m->neighbours[tet][face]; }

/* Computes the barycentric coordinates of x in tetrahedron `tet`. They sum to 1; inside, all are >= 0. RT */
void mesh_barycentric(const mesh *m, int tet, vec3 x, double weights[4]);

/* Returns the mesh's local edge length (m) in element `tet`: the mean node_size of its corners. RT */
double mesh_edge_length(const mesh *m, int tet);

/* Computes the barycentric coordinates of x in the tetrahedron with these corners. RT */
void tet_barycentric(const vec3 corners[4], vec3 x, double weights[4]);

/* Returns which corner of a tetrahedron the node is, or -1 if it is none. RT */
int mesh_corner_of(const mesh *m, int tet, int node);

/* Lists the tetrahedra around `node`, a node of tetrahedron `start`. Returns how many there are, or -1 if more than `most`. RT */
int mesh_around(const mesh *m, int node, int start, int *tets, int most);

void mesh_corners(const mesh *m, int tet, vec3 corners[4]); /* m */
double mesh_volume(const mesh *m, int tet);                 /* m^3 */
vec3 mesh_point(const mesh *m, int tet, const double weights[4]);

/* Returns the unit normal of a tetrahedron's face, pointing toward the opposite corner. RT */
vec3 mesh_face_normal(const mesh *m, int tet, int face);

/* Computes the gradients (1/m) of the four linear shape functions. Returns the volume. RT */
double tet_gradients(const vec3 corners[4], vec3 gradients[4]);

/* Finds where the segment from a to b first enters the body at rest from outside. Takes O(log boundary_count) time. RT */
typedef struct {
    bool hit;
    double fraction;         /* 0 to 1 along the segment */
    int tet, face;
    vec3 point;              /* m */
} surface_hit;
surface_hit mesh_enter(const mesh *m, vec3 a, vec3 b);

/* Returns the tetrahedron that contains x, or -1. Starts searching at tetrahedron `start` (-1: anywhere). Works for non-convex meshes, too. */
int mesh_locate(const mesh *m, vec3 x, int start);

/* Returns the face through which the ray from x along d leaves tetrahedron `tet`, and writes the distance, in units of d. Returns -1 if d is zero. A point
   slightly outside a face is treated as being on the face. RT */
int mesh_exit(const mesh *m, int tet, vec3 x, vec3 d, double *distance);

/* Compares two node indices, for qsort and bsearch. */
static inline int compare_nodes(const void *a, const void *b) { return *(const int *)a - *(const int *)b; }

#endif
