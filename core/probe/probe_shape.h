/* The surface of an ultrasound probe: a cylinder with a rounded end. */
#ifndef TROCAR_PROBE_SHAPE_H
#define TROCAR_PROBE_SHAPE_H

#include "base/vec.h"

/* The axis runs along local +z, from the base, where the hand holds the probe, to the tip at z = length. Behind the base, the cylinder continues. */
typedef struct {
    double radius;           /* m */
    double tip_radius;       /* m, radius of the rounded edge at the end; if equal to `radius`, the end is a hemisphere */
    double length;           /* m, from base to tip */
} probe_shape;

/* Returns the distance (m) of x from the surface, negative inside. Sets `normal` to the outward unit normal at the closest point on the surface. */
double probe_gap(const probe_shape *shape, pose base, vec3 x, vec3 *normal);

/* Returns how far (m) a point between base and tip moves at most from one pose to the other. */
double probe_way(const probe_shape *shape, pose from, pose to);

#endif
