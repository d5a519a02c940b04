#include "common/messages.h"

#include <string.h>

void store_vec3(vec3 v, double out[3]) {
    out[0] = v.x;
    out[1] = v.y;
    out[2] = v.z;
}

vec3 load_vec3(const double v[3]) { return v3(v[0], v[1], v[2]); }

pose load_pose(const double position[3], const double orientation[4]) {
    const double *q = orientation;
    return (pose){load_vec3(position), {q[0], q[1], q[2], q[3]}};
}

trocar_pose library_pose(pose p) {
    const vec3 x = p.position;
    const quat q = p.orientation;
    return (trocar_pose){{x.x, x.y, x.z}, {q.w, q.x, q.y, q.z}};
}

static int flags_of(uint32_t events) {
    int late = events & TROCAR_EVENT_LATE ? TROCAR_NEEDLE_WRENCH_T_LATE_WORKER : 0;
    int unstable = events & TROCAR_EVENT_UNSTABLE ? TROCAR_NEEDLE_WRENCH_T_UNSTABLE : 0;
    int missed = events & TROCAR_EVENT_MISSED_GUIDE ? TROCAR_NEEDLE_WRENCH_T_MISSED_GUIDE : 0;
    int outside = events & TROCAR_EVENT_OUTSIDE_MODEL ? TROCAR_NEEDLE_WRENCH_T_OUTSIDE_MODEL : 0;
    return late | unstable | missed | outside;
}

trocar_needle_wrench_t wrench_message(const trocar_output *output) {
    trocar_needle_wrench_t m = {.depth = output->depth, .contacts = output->contacts, .events = (int32_t)output->events,
                                .membrane = output->membrane, .flags = flags_of(output->events)};
    memcpy(m.force, output->force, sizeof m.force);
    memcpy(m.torque, output->torque, sizeof m.torque);
    memcpy(m.raw_force, output->force, sizeof m.raw_force);
    memcpy(m.raw_torque, output->torque, sizeof m.raw_torque);
    return m;
}
