#include "tissue/exact_fields.h"

#include <math.h>

vec3 line_axial(double x, double y) { return v3(0, 0, -log(hypot(x, y)) / (2.0 * M_PI)); }

double line_axial_radius(double u) { return exp(-2.0 * M_PI * u); }

/* -1/2: the mean of x^2 / rho^2 over a circle, so that the mean displacement of the circle is the logarithm alone. */
vec3 line_lateral(double x, double y, double poisson_ratio) {
    double square = x * x + y * y, c = 1.0 / (8.0 * M_PI * (1.0 - poisson_ratio));
    return v3(c * (-(3.0 - 4.0 * poisson_ratio) * 0.5 * log(square) + x * x / square - 0.5), c * x * y / square, 0);
}

vec3 line_traction(int axis, vec3 at, vec3 area, double poisson_ratio) {
    double x = at.x, y = at.y, square = x * x + y * y;
    if (axis == 2) return v3(-area.z * x / (2.0 * M_PI * square), -area.z * y / (2.0 * M_PI * square), -(area.x * x + area.y * y) / (2.0 * M_PI * square));
    if (axis == 1) { /* turned by a right angle about z */
        vec3 turned = line_traction(0, v3(y, -x, 0), v3(area.y, -area.x, area.z), poisson_ratio);
        return v3(-turned.y, turned.x, turned.z);
    }
    double c = 1.0 / (8.0 * M_PI * (1.0 - poisson_ratio) * square), k = 3.0 - 4.0 * poisson_ratio, xx = x * x / square, xy = x * y / square;
    double exx = c * x * (2.0 - k - 2.0 * xx), eyy = c * (x - 2.0 * y * xy), exy = 0.5 * c * (y - k * y - 4.0 * x * xy);
    double pressure = 2.0 * poisson_ratio / (1.0 - 2.0 * poisson_ratio) * (exx + eyy);
    return v3((pressure + 2.0 * exx) * area.x + 2.0 * exy * area.y, 2.0 * exy * area.x + (pressure + 2.0 * eyy) * area.y, pressure * area.z);
}

double line_lateral_logarithm(double u, double poisson_ratio) { return -8.0 * M_PI * (1.0 - poisson_ratio) * u / (3.0 - 4.0 * poisson_ratio); }

double line_lateral_radius(double u, double poisson_ratio) { return exp(line_lateral_logarithm(u, poisson_ratio)); }

vec3 kelvin_displacement(vec3 source, vec3 force, vec3 x, double poisson_ratio) {
    vec3 d = v3_sub(x, source);
    double r = v3_norm(d), c = 1.0 / (16.0 * M_PI * (1.0 - poisson_ratio) * r);
    return v3_axpy(c * (3.0 - 4.0 * poisson_ratio), force, v3_scale(c * v3_dot(d, force) / (r * r), d));
}

vec3 mindlin_displacement(vec3 source, vec3 force, vec3 at, double nu) {
    double c = source.z, x = at.x - source.x, y = at.y - source.y, z = at.z, below = z - c, above = z + c;
    double r1 = sqrt(x * x + y * y + below * below), r2 = sqrt(x * x + y * y + above * above);
    double r1_3 = r1 * r1 * r1, r2_3 = r2 * r2 * r2, r2_5 = r2_3 * r2 * r2, k = 3.0 - 4.0 * nu, q = 4.0 * (1.0 - nu) * (1.0 - 2.0 * nu);
    double reach = r2 + above;
    /* a force normal to the surface moves the point outward from the axis and along it; */
    double outward = below / r1_3 + k * below / r2_3 - q / (r2 * reach) + 6.0 * c * z * above / r2_5;
    double along = k / r1 + (8.0 * (1.0 - nu) * (1.0 - nu) - k) / r2 + below * below / r1_3
                 + (k * above * above - 2.0 * c * z) / r2_3 + 6.0 * c * z * above * above / r2_5;
    /* one parallel to it: A f + B (f . d) d in the plane, and a normal part */
    double a = k / r1 + 1.0 / r2 + 2.0 * c * z / r2_3 + q / reach;
    double b = 1.0 / r1_3 + k / r2_3 - 6.0 * c * z / r2_5 - q / (r2 * reach * reach);
    double lifted = below / r1_3 + k * below / r2_3 - 6.0 * c * z * above / r2_5 + q / (r2 * reach);
    double d = force.x * x + force.y * y;
    vec3 u = {a * force.x + b * d * x + force.z * outward * x, a * force.y + b * d * y + force.z * outward * y, lifted * d + force.z * along};
    return v3_scale(1.0 / (16.0 * M_PI * (1.0 - nu)), u);
}
