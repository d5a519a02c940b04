/* The surface of an ultrasound probe: a cylinder with a rounded end. */
#ifndef TROCAR_PROBE_SHAPE_H
#define TROCAR_PROBE_SHAPE_H

#include "base/vec.h"

/* The axis is the probe's local +z, from its base, where the hand holds it, to its tip at z = length. The cylinder also extends behind the base. */
typedef struct {
    double radius;           /* m */
    double tip_radius;       /* m, radius of the rounded edge at its end; if it is equal to `radius`, the end is a hemisphere */
    double length;           /* m, from base to tip */
} probe_shape;

/* Distance (m) of x from the surface, negative inside, and the outward unit normal at the closest point on the surface. */
double probe_gap(const probe_shape *shape, pose base, vec3 x, vec3 *normal);

/* Largest distance (m) that a point between base and tip moves between two poses. */
double probe_way(const probe_shape *shape, pose from, pose to);

#endif
