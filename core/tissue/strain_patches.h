/* Disjoint patches of tetrahedra over which STRAIN_BY_PATCH averages the volumetric strain. */
#ifndef TROCAR_STRAIN_PATCHES_H
#define TROCAR_STRAIN_PATCHES_H

#include "mesh/mesh.h"

/* Divides the mesh into patches of tetrahedra that are in the same region and connected by faces. A patch usually has 8 tetrahedra. It has a few more if
   leftovers were added to it, and fewer than 4 only if its connected component of the region has fewer. Sets patch[tet_count], numbered from 0, and the number
   of patches. Compares only integers, so the same mesh gives the same patches on every machine. */
trocar_status strain_patches_create(const mesh *m, int *patch, int *patch_count, trocar_error *why);

#endif
