/* The motion of a region as a whole: the rigid motion that best fits the displacements of its nodes. */
#ifndef TROCAR_REGION_MOTION_H
#define TROCAR_REGION_MOTION_H

#include "base/error.h"
#include "base/vec.h"
#include "trocar.h"

typedef struct {
    vec3 shift;              /* m, of the points' centroid */
    vec3 turn;               /* rad, rotation vector about the centroid */
} rigid_motion;

/* Least-squares fit to `count` points that moved from `from` to `from + displacement`. Returns the shift of the centroid and the rotation of Kabsch 1976,
   computed as the polar factor of the covariance by Newton's method (Higham 1986). The rotation is zero if the points are coplanar, or if the covariance has a
   negative determinant (a reflection). */
rigid_motion rigid_motion_fit(int count, const vec3 *from, const vec3 *displacement);

/* The nodes of the region to follow. */
typedef struct {
    int count;
    int *nodes;              /* [count], in ascending order */
    vec3 *from, *displacement; /* [count], m */
} region_motion;

/* Finds the region's nodes. Returns BAD_INPUT if the mesh has no volume of this name. */
trocar_status region_motion_create(const trocar_model *model, const char *region, region_motion *motion, trocar_error *why);
void region_motion_free(region_motion *motion);

/* Returns how the region moved, given the displacements of the mesh's nodes (3 node_count, m). */
rigid_motion region_motion_of(region_motion *motion, const double *displacements);

#endif
