/* Disjoint patches of tetrahedra over which STRAIN_BY_PATCH averages the volumetric strain. */
#ifndef TROCAR_STRAIN_PATCHES_H
#define TROCAR_STRAIN_PATCHES_H

#include "tissue/mesh.h"

/* Divides the mesh into patches of tetrahedra of one region that are connected by faces: 8 each as a rule, a few more where a
   remainder was added, and no fewer than 4 unless the region, or a part of it without a face to the rest, has no more. Sets patch[tet_count], numbered from 0, and their number. Only
   integers are compared, so the same mesh gives the same patches on every machine. */
trocar_status strain_patches_create(const mesh *m, int *patch, int *patch_count, report *why);

#endif
