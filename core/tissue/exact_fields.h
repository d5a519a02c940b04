/* Displacements due to forces in an infinite elastic body and in a half-space, for unit force and unit shear modulus. Meshes too coarse to resolve these fields
   are compared with them. */
#ifndef TROCAR_EXACT_FIELDS_H
#define TROCAR_EXACT_FIELDS_H

#include "base/vec.h"

/* Displacement at (x, y) due to a force per unit length along an infinite line, the z axis: Kelvin's solution in plane strain (lateral: the line is pushed
   along x), and anti-plane shear (axial: pushed along z). The additive constants make the displacement at rho = R that of a rigid cylinder of radius R around
   the line. Dimensionless: displacement (m) times shear modulus (Pa) divided by the line force (N/m). */
vec3 line_lateral(double x, double y, double poisson_ratio);
vec3 line_axial(double x, double y);

/* Returns the force that the stress in these fields exerts on a small surface with this area vector, in N per N/m on the line. Axes 0 and 1: the line is pushed
   along x and y; axis 2: along z. */
vec3 line_traction(int axis, vec3 x, vec3 area, double poisson_ratio);

/* Displacement due to a force per unit length in the direction `axis`, applied to the z axis between z = from and z = to (the integral of Kelvin's solution for
   a point force); and the force on a small surface, as in line_traction. */
typedef struct {
    int axis;
    double from, to;
} line_segment;
vec3 segment_displacement(const line_segment *line, vec3 x, double poisson_ratio);
vec3 segment_traction(const line_segment *line, vec3 x, vec3 area, double poisson_ratio);

/* Returns the lateral displacement of a circle of this radius around the line due to a lateral force on the part of the line that is `from` to `to` (m) ahead
   of the circle. It is averaged over the circumference and expressed as the logarithm of a radius. */
double segment_logarithm(double from, double to, double radius, double poisson_ratio);

/* Returns the radius of the rigid cylinder that the force of line_lateral or line_axial displaces by `u`. */
double line_lateral_radius(double u, double poisson_ratio);
double line_axial_radius(double u);

/* Returns the logarithm of the ratio of radii whose lateral displacements differ by `u`. */
double line_lateral_logarithm(double u, double poisson_ratio);

/* Returns the displacement (1/m) at `x` due to a unit force at `source`, in a body whose free surface is the plane z = 0; source.z >= 0, x.z >= 0. Mindlin,
   Physics 7, 195 (1936). Far below the surface, it approaches Kelvin's solution. */
vec3 mindlin_displacement(vec3 source, vec3 force, vec3 x, double poisson_ratio);

/* Returns the displacement at `x` due to a unit force at `source` in an infinite body: Kelvin's solution. */
vec3 kelvin_displacement(vec3 source, vec3 force, vec3 x, double poisson_ratio);

#endif
