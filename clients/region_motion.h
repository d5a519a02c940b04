/* How a region moves as a whole under the needle: the rigid motion that is nearest to the displacement of its nodes. */
#ifndef TROCAR_REGION_MOTION_H
#define TROCAR_REGION_MOTION_H

#include "insertion/simulation.h"

typedef struct {
    vec3 shift;              /* m, of the points' centroid */
    vec3 turn;               /* rad, rotation vector about the centroid */
} rigid_motion;

/* Least squares over `count` points at `from` that went to `from + displacement`: shift of the centroid and the rotation of
   Kabsch 1976, as the polar factor of the covariance by Newton's iteration (Higham 1986). No rotation for points of one
   plane, or turned so far that the covariance is a reflection. */
rigid_motion rigid_motion_fit(int count, const vec3 *from, const vec3 *displacement);

/* Follows the nodes of one region of a simulation, tick by tick. */
typedef struct {
    const mesh_group *region;
    vec3 *from, *displacement;   /* the region's node_count; m */
    vec3 *nominal;               /* the mesh's node_count; m */
} region_motion;

/* BAD_INPUT if the mesh has no region of this name. */
trocar_status region_motion_create(const simulation *s, const char *region, region_motion *motion, report *why);
void region_motion_free(region_motion *motion);

/* Of the state, against the unloaded tissue. */
rigid_motion region_motion_now(simulation *s, const insertion_state *state, region_motion *motion);

#endif
