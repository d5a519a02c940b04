#include "linalg/plane_tensor.h"

#include "base/vec.h"

/* Computes the axes of the plane across the track. */
static void axes_across(vec3 direction, vec3 *x, vec3 *y) {
    mat3 frame = frame_along(direction);
    *x = m3_column(&frame, 0);
    *y = m3_column(&frame, 1);
}

plane_tensor plane_part(const mat3 *tensor, vec3 direction) {
    vec3 x, y;
    axes_across(direction, &x, &y);
    vec3 by_x = m3_apply(tensor, x), by_y = m3_apply(tensor, y);
    return (plane_tensor){v3_dot(x, by_x), v3_dot(x, by_y), v3_dot(y, by_y)};
}

/* Returns the square of half the difference between the principal values. */
static double square_spread_of(plane_tensor t) {
    double half = 0.5 * (t.xx - t.yy);
    return half * half + t.xy * t.xy;
}

plane_tensor plane_at_least(plane_tensor t, double least) {
    double mean = plane_mean(t), square = square_spread_of(t);
    if (mean >= least && (mean - least) * (mean - least) >= square) return t;
    double spread = sqrt(square), larger = larger_of(mean + spread, least), part = spread > 0.0 ? 0.5 * (larger - least) / spread : 0.0;
    double middle = 0.5 * (larger + least), half = 0.5 * part * (t.xx - t.yy);
    return (plane_tensor){middle + half, part * t.xy, middle - half};
}

principal_tensor plane_principal(plane_tensor t, vec3 direction) {
    vec3 x, y;
    axes_across(direction, &x, &y);
    double spread = sqrt(square_spread_of(t)), double_cosine = spread > 0.0 ? 0.5 * (t.xx - t.yy) / spread : 1.0; /* double_cosine: cosine of twice the angle to
                                                                                                                     the x axis */
    double cosine = sqrt(larger_of(0.5 * (1.0 + double_cosine), 0.0)), sine = copysign(sqrt(larger_of(0.5 * (1.0 - double_cosine), 0.0)), t.xy);
    return (principal_tensor){plane_mean(t) - spread, 2.0 * spread, v3_axpy(cosine, x, v3_scale(sine, y))};
}
