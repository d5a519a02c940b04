/* Reads Gmsh's MSH files, versions 2.2 and 4.1, text and binary. Thread-safe. */
#ifndef TROCAR_MSH_READER_H
#define TROCAR_MSH_READER_H

#include "mesh/mesh.h"

enum { MSH_TRIANGLE = 2, MSH_TETRAHEDRON = 4 }; /* Gmsh's numbers for the linear element types */

typedef struct { uint64_t tag; double x[3]; } msh_node; /* coordinates as in the file */

typedef struct {
    int dimension, entity;   /* the model entity to which the element belongs */
    int type;                /* Gmsh's element type */
    uint64_t number;         /* in version 2.2, the number in the file; in version 4.1, its position in the file */
    size_t first;            /* index of its first node: corners[first ..] */
} msh_element;

typedef struct { int dimension, entity, tag; } msh_membership;                   /* the entity belongs to the physical group `tag` */
typedef struct { int dimension, tag; char text[MESH_NAME + 1]; } msh_name;       /* has room for one more character than a group's name, so that names that
                                                                                    are too long can be detected */

/* What is needed from a file to create a mesh. */
typedef struct {
    size_t node_count, element_count, corner_count, membership_count, name_count;
    msh_node *nodes;         /* array of node_count nodes, sorted by tag, without duplicates */
    msh_element *elements;   /* array of element_count elements, sorted by dimension, entity and number; those of dimension 3 are all tetrahedra */
    uint64_t *corners;       /* array of corner_count node tags, in file order */
    msh_membership *memberships; /* array of membership_count entries, sorted by dimension, entity and tag, without duplicates; tags are >= 0 */
    msh_name *names;         /* array of name_count names of physical groups, in file order */
} msh_contents;

/* Returns how many nodes an element of this type has; 0 if the type is unknown. */
int msh_element_nodes(int type);

/* True if msh_read can read the file's format. Leaves the file position undefined. */
bool msh_is_readable(FILE *file);

/* Reads the whole file. Messages name `path` and the line or byte; not the latter if `file` was `converted` from `path`. BAD_INPUT, NO_MEMORY. Release
   `contents` with msh_free, even after a failure. */
trocar_status msh_read(FILE *file, const char *path, bool converted, msh_contents *contents, trocar_error *why);
void msh_free(msh_contents *contents);

#endif
