#include "tissue/exact_fields.h"

#include <math.h>

vec3 line_axial(double x, double y) { return v3(0, 0, -log(hypot(x, y)) / (2.0 * M_PI)); }

double line_axial_radius(double u) { return exp(-2.0 * M_PI * u); }

/* The term -1/2 cancels the mean of x^2 / rho^2 over a circle, so that the circle's mean displacement is just the logarithm. */
vec3 line_lateral(double x, double y, double poisson_ratio) {
    double square = x * x + y * y, c = 1.0 / (8.0 * M_PI * (1.0 - poisson_ratio));
    return v3(c * (-(3.0 - 4.0 * poisson_ratio) * 0.5 * log(square) + x * x / square - 0.5), c * x * y / square, 0);
}

vec3 line_traction(int axis, vec3 at, vec3 area, double poisson_ratio) {
    double x = at.x, y = at.y, square = x * x + y * y;
    if (axis == 2) return v3(-area.z * x / (2.0 * M_PI * square), -area.z * y / (2.0 * M_PI * square), -(area.x * x + area.y * y) / (2.0 * M_PI * square));
    if (axis == 1) { /* rotated by a right angle about z */
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

/* Integrals of 1/r, 1/r^3, z/r^3 and z^2/r^3 over a segment, and their gradients. r: distance of x from a point of the segment; z: coordinate of x relative to
   that point. */
typedef struct {
    double value[4];
    vec3 gradient[4];
} segment_integrals;

/* Returns r + z without cancellation. */
static double reached(double z, double r, double square) { return z > 0.0 ? r + z : square / (r - z); }

static segment_integrals integrate(const line_segment *line, vec3 x) {
    double square = fmax(x.x * x.x + x.y * x.y, 1e-24), a = x.z - line->to, b = x.z - line->from;
    double ra = sqrt(square + a * a), rb = sqrt(square + b * b), cosines = b / rb - a / ra, cubes = b / (rb * rb * rb) - a / (ra * ra * ra);
    segment_integrals s;
    s.value[0] = log(reached(b, rb, square) / reached(a, ra, square));
    s.value[1] = cosines / square;
    s.value[2] = 1.0 / ra - 1.0 / rb;
    s.value[3] = s.value[0] - cosines;
    double outward[] = {-s.value[1], -(2.0 * s.value[1] + cubes) / square, 1.0 / (rb * rb * rb) - 1.0 / (ra * ra * ra), cubes - s.value[1]}; /* radial
                                                                                                                                                derivatives,
                                                                                                                                                divided by
                                                                                                                                                rho */
    double along[] = {1.0 / rb - 1.0 / ra, 1.0 / (rb * rb * rb) - 1.0 / (ra * ra * ra), cubes, b * b / (rb * rb * rb) - a * a / (ra * ra * ra)};
    for (int i = 0; i < 4; i++) s.gradient[i] = v3(outward[i] * x.x, outward[i] * x.y, along[i]);
    return s;
}

vec3 segment_displacement(const line_segment *line, vec3 x, double poisson_ratio) {
    segment_integrals s = integrate(line, x);
    double c = 1.0 / (16.0 * M_PI * (1.0 - poisson_ratio)), k = 3.0 - 4.0 * poisson_ratio, *i = s.value;
    switch (line->axis) {
    case 0: return v3(c * (k * i[0] + x.x * x.x * i[1]), c * x.x * x.y * i[1], c * x.x * i[2]);
    case 1: return v3(c * x.x * x.y * i[1], c * (k * i[0] + x.y * x.y * i[1]), c * x.y * i[2]);
    default: return v3(c * x.x * i[2], c * x.y * i[2], c * (k * i[0] + i[3]));
    }
}

/* Applies Hooke's law to the gradient of segment_displacement(). */
vec3 segment_traction(const line_segment *line, vec3 x, vec3 area, double poisson_ratio) {
    segment_integrals s = integrate(line, x);
    double c = 1.0 / (16.0 * M_PI * (1.0 - poisson_ratio)), k = 3.0 - 4.0 * poisson_ratio;
    vec3 ex = v3(1, 0, 0), ey = v3(0, 1, 0), e = line->axis == 0 ? ex : ey, row[3]; /* row: gradients of the displacement components */
    const vec3 *g = s.gradient;
    double aside = line->axis == 0 ? x.x : x.y;
    vec3 even = v3_axpy(k, g[0], v3_axpy(aside * aside, g[1], v3_scale(2.0 * aside * s.value[1], e)));
    vec3 mixed = v3_axpy(x.x * x.y, g[1], v3_axpy(x.y * s.value[1], ex, v3_scale(x.x * s.value[1], ey)));
    vec3 lift_x = v3_axpy(x.x, g[2], v3_scale(s.value[2], ex)), lift_y = v3_axpy(x.y, g[2], v3_scale(s.value[2], ey));
    switch (line->axis) {
    case 0: row[0] = even; row[1] = mixed; row[2] = lift_x; break;
    case 1: row[0] = mixed; row[1] = even; row[2] = lift_y; break;
    default: row[0] = lift_x; row[1] = lift_y; row[2] = v3_axpy(k, g[0], g[3]); break;
    }
    double pressure = 2.0 * poisson_ratio / (1.0 - 2.0 * poisson_ratio) * (row[0].x + row[1].y + row[2].z);
    vec3 t = v3_scale(pressure, area), turned = v3_axpy(area.x, row[0], v3_axpy(area.y, row[1], v3_scale(area.z, row[2])));
    return v3_scale(c, v3_add(v3_add(t, turned), v3(v3_dot(row[0], area), v3_dot(row[1], area), v3_dot(row[2], area))));
}

/* On a circle, the mean of x^2 is rho^2 / 2. */
double segment_logarithm(double from, double to, double radius, double poisson_ratio) {
    double logarithm = asinh(to / radius) - asinh(from / radius), cosines = to / hypot(to, radius) - from / hypot(from, radius);
    return line_lateral_logarithm(((3.0 - 4.0 * poisson_ratio) * logarithm + 0.5 * cosines) / (16.0 * M_PI * (1.0 - poisson_ratio)), poisson_ratio);
}

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
    /* a force normal to the surface moves the point along the axis and away from it */
    double outward = below / r1_3 + k * below / r2_3 - q / (r2 * reach) + 6.0 * c * z * above / r2_5;
    double along = k / r1 + (8.0 * (1.0 - nu) * (1.0 - nu) - k) / r2 + below * below / r1_3
                 + (k * above * above - 2.0 * c * z) / r2_3 + 6.0 * c * z * above * above / r2_5;
    /* a force f parallel to the surface moves the point by A f + B (f . d) d in the plane, plus a normal component */
    double a = k / r1 + 1.0 / r2 + 2.0 * c * z / r2_3 + q / reach;
    double b = 1.0 / r1_3 + k / r2_3 - 6.0 * c * z / r2_5 - q / (r2 * reach * reach);
    double lifted = below / r1_3 + k * below / r2_3 - 6.0 * c * z * above / r2_5 + q / (r2 * reach);
    double d = force.x * x + force.y * y;
    vec3 u = {a * force.x + b * d * x + force.z * outward * x, a * force.y + b * d * y + force.z * outward * y, lifted * d + force.z * along};
    return v3_scale(1.0 / (16.0 * M_PI * (1.0 - nu)), u);
}
