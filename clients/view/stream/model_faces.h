/* The faces of a model's tetrahedra. */
#ifndef TROCAR_MODEL_FACES_H
#define TROCAR_MODEL_FACES_H

#include <stdbool.h>

#include "trocar.h"

/* Corners of the face opposite each corner of a tetrahedron, counter-clockwise as seen from outside. */
static const int FACE_CORNERS[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

/* True if the other side of the face is a different region, or no tissue. */
static inline bool face_bounds_region(const trocar_model *model, int tet, int face) {
    const int32_t *regions = trocar_model_tet_regions(model);
    int neighbour = trocar_model_neighbours(model)[4 * tet + face];
    return neighbour < 0 || regions[neighbour] != regions[tet];
}

#endif
