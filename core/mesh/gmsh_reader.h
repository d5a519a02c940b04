/* State while Gmsh reads one mesh file; included by mesh_gmsh.c and gmsh_groups.c only. */
#ifndef TROCAR_GMSH_READER_H
#define TROCAR_GMSH_READER_H

#include "mesh/mesh.h"

enum { GMSH_TRIANGLE = 2, GMSH_TETRAHEDRON = 4 }; /* Gmsh's element types, linear */

typedef struct { size_t tag; int index; } numbered_node;

typedef struct {
    const char *path;
    double unit;             /* m */
    mesh *mesh;
    report *why;
    numbered_node *nodes;    /* all nodes of the file by ascending tag; index -1 if no tetrahedron uses the node */
    int node_count;
    double *coordinates;     /* 3 node_count, in the order of `nodes` */
    size_t *corners;         /* 4 tet_count: node tags */
    int (*triangles)[3];     /* of all named surfaces, node indices */
    int *triangle_group;
    int triangle_count;
} gmsh_reader;

/* Fail with a message: out of memory; Gmsh's last error. */
trocar_status reader_no_memory(gmsh_reader *r);
trocar_status reader_gmsh_failed(gmsh_reader *r);

/* Index of the node with this tag, -1 if no tetrahedron uses it. */
int reader_node(const gmsh_reader *r, size_t tag);

/* Reads the physical groups in Gmsh's order (by dimension, then tag), without their nodes. If there is no physical volume, all tetrahedra form the
   region "tissue". `tags` receives the tag of each group. */
trocar_status read_groups(gmsh_reader *r, int tags[MESH_MAX_GROUPS]);

/* Index of the group of this dimension and tag, or -1. */
int group_of_tag(const gmsh_reader *r, const int tags[], int dimension, int tag);

/* Reads the nodes of group `g`, and the triangles of a surface, once all tetrahedra have been read. */
trocar_status read_group_nodes(gmsh_reader *r, int g, int tag);

#endif
