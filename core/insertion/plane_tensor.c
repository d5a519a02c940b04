#include "insertion/plane_tensor.h"

#include "tissue/neighbourhood.h"

plane_tensor plane_part(const mat3 *tensor, vec3 direction) {
    mat3 frame = frame_along(direction), half = m3_multiply(tensor, &frame), back = m3_transposed(&frame), turned = m3_multiply(&back, &half);
    return (plane_tensor){turned.m[0][0], turned.m[0][1], turned.m[1][1]};
}

/* Half the difference of the principal values. */
static double spread_of(plane_tensor t) {
    double half = 0.5 * (t.xx - t.yy);
    return sqrt(half * half + t.xy * t.xy);
}

plane_tensor plane_at_least(plane_tensor t, double least) {
    double mean = 0.5 * (t.xx + t.yy), spread = spread_of(t);
    if (mean - spread >= least) return t;
    double larger = larger_of(mean + spread, least), part = spread > 0.0 ? 0.5 * (larger - least) / spread : 0.0;
    double middle = 0.5 * (larger + least), half = 0.5 * part * (t.xx - t.yy);
    return (plane_tensor){middle + half, part * t.xy, middle - half};
}

principal_tensor plane_principal(plane_tensor t, vec3 direction) {
    mat3 frame = frame_along(direction);
    double spread = spread_of(t), double_cosine = spread > 0.0 ? 0.5 * (t.xx - t.yy) / spread : 1.0; /* of twice the angle to x */
    double cosine = sqrt(larger_of(0.5 * (1.0 + double_cosine), 0.0)), sine = copysign(sqrt(larger_of(0.5 * (1.0 - double_cosine), 0.0)), t.xy);
    vec3 x = v3(frame.m[0][0], frame.m[1][0], frame.m[2][0]), y = v3(frame.m[0][1], frame.m[1][1], frame.m[2][1]);
    return (principal_tensor){0.5 * (t.xx + t.yy) - spread, 2.0 * spread, v3_axpy(cosine, x, v3_scale(sine, y))};
}
