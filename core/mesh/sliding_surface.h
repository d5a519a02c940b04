/* Surfaces on which organs slide: the tissue on each side gets nodes of its own. */
#ifndef TROCAR_SLIDING_SURFACE_H
#define TROCAR_SLIDING_SURFACE_H

#include "mesh/mesh.h"

/* The faces of the named surface `group` that lie between two regions, one of which is `beside` (group index of a region; -1: any). */
typedef struct {
    int group, beside;
} sliding_surface;

/* Lets the tissue slide on these surfaces. A node of their faces is split unless the elements around it are still connected across other faces, as at the rim
   of a surface. Copies are numbered after all other nodes and belong to the same groups as their originals. Call it once, on a finished mesh. BAD_INPUT if a
   surface has no such faces; the message names the mesh, `name`. */
trocar_status mesh_let_slide(mesh *m, int count, const sliding_surface *surfaces, const char *name, trocar_error *why);

#endif
