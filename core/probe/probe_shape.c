#include "probe/probe_shape.h"

/* The shape is a thinner cylinder with a flat end, grown by the tip radius on all sides. (beside, beyond) is where x lies relative to the thinner cylinder's
   side and end, in the plane through x and the axis. */
double probe_gap(const probe_shape *shape, pose base, vec3 x, vec3 *normal) {
    vec3 local = q_rotate(q_conjugate(base.orientation), v3_sub(x, base.position)), radial = v3(local.x, local.y, 0.0);
    double from_axis = v3_norm(radial);
    radial = from_axis > 0.0 ? v3_scale(1.0 / from_axis, radial) : v3(1, 0, 0);
    double beside = from_axis - (shape->radius - shape->tip_radius), beyond = local.z - (shape->length - shape->tip_radius), distance;
    if (beside > 0.0 && beyond > 0.0) {
        distance = hypot(beside, beyond);
        radial = v3_scale(1.0 / distance, v3(beside * radial.x, beside * radial.y, beyond));
    } else {
        distance = fmax(beside, beyond);
        if (beyond > beside) radial = v3(0, 0, 1);
    }
    *normal = q_rotate(base.orientation, radial);
    return distance - shape->tip_radius;
}

double probe_way(const probe_shape *shape, pose from, pose to) {
    vec3 tip = v3(0, 0, shape->length);
    vec3 before = v3_add(from.position, q_rotate(from.orientation, tip)), after = v3_add(to.position, q_rotate(to.orientation, tip));
    return fmax(v3_norm(v3_sub(to.position, from.position)), v3_norm(v3_sub(after, before)));
}
