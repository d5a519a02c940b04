/* Displacements by forces in an infinite elastic body and below a free plane surface, for unit force and unit shear modulus. Meshes that are too coarse to
   resolve these fields are compared with them. */
#ifndef TROCAR_EXACT_FIELDS_H
#define TROCAR_EXACT_FIELDS_H

#include "base/vec.h"

/* Displacement at (x, y) under a force per length along an infinite line, the z axis: Kelvin's solution in plane strain (lateral: the line is pushed along x),
   and anti-plane shear (axial: along z). Additive constants are chosen such that the displacement at rho = R equals that of a rigid cylinder of radius R
   around the line. The unit 1/m means N/m over Pa. */
vec3 line_lateral(double x, double y, double poisson_ratio);
vec3 line_axial(double x, double y);

/* Traction of these line fields on a surface with this area vector, N per N/m of the line; axis 0, 1: the line is pushed along x, y; 2: along z. */
vec3 line_traction(int axis, vec3 x, vec3 area, double poisson_ratio);

/* Displacement under a force per length between two points of the z axis, in the direction `axis`: Kelvin's solution for a point force, integrated; and the
   traction of this field. */
typedef struct {
    int axis;
    double from, to;
} line_segment;
vec3 segment_displacement(const line_segment *line, vec3 x, double poisson_ratio);
vec3 segment_traction(const line_segment *line, vec3 x, vec3 area, double poisson_ratio);

/* Displacement of a cylinder of this radius around the line by the part of the line between `from` and `to` ahead of it, pushed across: a mean over its
   circumference, expressed as the logarithm of a radius. */
double segment_logarithm(double from, double to, double radius, double poisson_ratio);

/* Radius of the cylinder that moves by `u` under the same force. */
double line_lateral_radius(double u, double poisson_ratio);
double line_axial_radius(double u);

/* Logarithm of the ratio of radii that corresponds to a difference of displacements across the line. */
double line_lateral_logarithm(double u, double poisson_ratio);

/* Displacement at `x` under a unit force at `source`, in a body whose free surface is the plane z = 0; source.z >= 0, x.z >= 0. Mindlin, Physics 7, 195
   (1936). Far below the surface, it approaches Kelvin's solution. 1/m */
vec3 mindlin_displacement(vec3 source, vec3 force, vec3 x, double poisson_ratio);

/* Displacement at `x` under a unit force at `source` in an infinite body: Kelvin's solution. */
vec3 kelvin_displacement(vec3 source, vec3 force, vec3 x, double poisson_ratio);

#endif
