#include "mapping.h"

/* Returns the shortest rotation that takes the z axis to this direction. */
static quat along(vec3 direction) {
    vec3 d = v3_unit(direction);
    if (d.z < -0.999999) return (quat){0, 1, 0, 0};
    return q_unit((quat){1 + d.z, -d.y, d.x, 0});
}

void mapping_init(mapping *m, const mapping_settings *settings) {
    *m = (mapping){.set = *settings, .turn = {1, 0, 0, 0}, .orientation = along(settings->direction)};
}

static vec3 in_scene(const mapping *m, vec3 position) { return v3_scale(m->set.scale, q_rotate(m->set.rotation, position)); }

static quat turned_by_hand(const mapping *m, const quat *handle) {
    return q_multiply(q_multiply(m->set.rotation, *handle), m->set.tool);
}

static vec3 reach(const mapping *m, quat orientation) { return v3_scale(m->set.tip ? m->set.length : 0, q_axis(orientation)); }

static void clutch_released(mapping *m, vec3 position, const quat *handle) {
    vec3 point = v3_add(m->held.position, reach(m, m->held.orientation));
    m->origin = v3_sub(point, in_scene(m, position));
    if (handle) m->turn = q_unit(q_multiply(q_conjugate(turned_by_hand(m, handle)), m->held.orientation));
}

pose mapping_pose(mapping *m, vec3 position, const quat *handle, bool clutch) {
    if (!handle) clutch = m->clutched; /* without a handle, the button's state is unknown, so leave the clutch as it was */
    if (m->set.fixed) handle = NULL;
    if (!m->placed) m->origin = m->set.has_offset ? m->set.offset : v3_sub(m->set.start, in_scene(m, position));
    if (m->clutched && !clutch) clutch_released(m, position, handle);
    if (m->placed && m->clutched && clutch) return m->held;
    m->placed = true;
    m->clutched = clutch;
    if (handle) m->orientation = q_unit(q_multiply(turned_by_hand(m, handle), m->turn));
    vec3 point = v3_add(m->origin, in_scene(m, position));
    m->held = (pose){v3_sub(point, reach(m, m->orientation)), m->orientation};
    return m->held;
}

vec3 mapping_force(const mapping *m, vec3 in_scene) { return q_rotate(q_conjugate(m->set.rotation), in_scene); }
