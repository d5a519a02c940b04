/* Reads Gmsh's MSH files, versions 2.2 and 4.1, text and binary. Thread-safe. */
#ifndef TROCAR_MSH_READER_H
#define TROCAR_MSH_READER_H

#include "mesh/mesh.h"

enum { MSH_TRIANGLE = 2, MSH_TETRAHEDRON = 4 }; /* Gmsh's element types, linear */

typedef struct { uint64_t tag; double x[3]; } msh_node; /* coordinates as in the file */

typedef struct {
    int dimension, entity;   /* the model entity that the element belongs to */
    int type;                /* Gmsh's element type */
    uint64_t number;         /* the file's in version 2.2; ascending in the order of the file in version 4.1 */
    size_t first;            /* its nodes: corners[first ..] */
} msh_element;

typedef struct { int dimension, entity, tag; } msh_membership;                   /* the entity is in the physical group `tag` */
typedef struct { int dimension, tag; char text[MESH_NAME + 1]; } msh_name;       /* cut off one character above what a group's name can hold */

/* What a file contains, of all that a mesh needs. */
typedef struct {
    size_t node_count, element_count, corner_count, membership_count, name_count;
    msh_node *nodes;         /* node_count, by ascending tag, each tag once */
    msh_element *elements;   /* element_count, by dimension, entity and number; tetrahedra are the only ones of dimension 3 */
    uint64_t *corners;       /* corner_count: tags of nodes, in the order of the file */
    msh_membership *memberships; /* membership_count, by dimension, entity and tag, each once; tags are not negative */
    msh_name *names;         /* name_count, of physical groups, in the order of the file */
} msh_contents;

/* Number of nodes of an element of this type; 0: unknown. */
int msh_element_nodes(int type);

/* True if the file has a format that msh_read reads. Leaves the position in the file undefined. */
bool msh_is_readable(FILE *file);

/* Reads the whole file. `path`: for messages, which tell the line or byte, except if `file` was `converted` from path. BAD_INPUT, NO_MEMORY. Release
   `contents` with msh_free, also after a failure. */
trocar_status msh_read(FILE *file, const char *path, bool converted, msh_contents *contents, report *why);
void msh_free(msh_contents *contents);

#endif
