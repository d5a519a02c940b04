/* Bounding-volume tree over the triangles of a mesh's outer surface; searched by mesh_enter (mesh.h). */
#ifndef TROCAR_SURFACE_TREE_H
#define TROCAR_SURFACE_TREE_H

#include "mesh/mesh.h"

/* Builds the tree (`bvh` and `bvh_order`) over `boundary`. Returns false if out of memory. */
bool surface_tree_build(mesh *m);

#endif
