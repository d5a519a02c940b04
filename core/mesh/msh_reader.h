/* Reads Gmsh's MSH files of versions 2.2 and 4.1, in text and binary form. Thread-safe. */
#ifndef TROCAR_MSH_READER_H
#define TROCAR_MSH_READER_H

#include "mesh/mesh.h"

enum { MSH_TRIANGLE = 2, MSH_TETRAHEDRON = 4 }; /* Gmsh's numbers for the linear element types */

typedef struct { uint64_t tag; double x[3]; } msh_node; /* coordinates as in the file */

typedef struct {
    int dimension, entity;   /* the model entity to which the element belongs */
    int type;                /* Gmsh's element type */
    uint64_t number;         /* in version 2.2, the number in the file; in version 4.1, a number that increases in the order of the file */
    size_t first;            /* index of its first node: corners[first ..] */
} msh_element;

typedef struct { int dimension, entity, tag; } msh_membership;                   /* the entity belongs to the physical group `tag` */
typedef struct { int dimension, tag; char text[MESH_NAME + 1]; } msh_name;       /* a name longer than a group's name may be is cut off one character beyond
                                                                                    that limit, so that the excess can be detected */

/* The parts of a file that are needed to create a mesh. */
typedef struct {
    size_t node_count, element_count, corner_count, membership_count, name_count;
    msh_node *nodes;         /* array of node_count nodes, sorted by tag, without duplicates */
    msh_element *elements;   /* array of element_count elements, sorted by dimension, entity and number; those of dimension 3 are all tetrahedra */
    uint64_t *corners;       /* array of corner_count node tags, in the order of the file */
    msh_membership *memberships; /* array of membership_count entries, sorted by dimension, entity and tag, without duplicates; tags are >= 0 */
    msh_name *names;         /* array of name_count names of physical groups, in the order of the file */
} msh_contents;

/* Returns the number of nodes of an element of this type; 0 if the type is unknown. */
int msh_element_nodes(int type);

/* Returns true if msh_read can read the file's format. Afterwards, the position in the file is undefined. */
bool msh_is_readable(FILE *file);

/* Reads the whole file. `path` is used in messages, which also give the line or byte, unless `file` was `converted` from path. BAD_INPUT, NO_MEMORY.
   `contents` must be released with msh_free, also after a failure. */
trocar_status msh_read(FILE *file, const char *path, bool converted, msh_contents *contents, trocar_error *why);
void msh_free(msh_contents *contents);

#endif
