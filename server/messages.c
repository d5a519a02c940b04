#include "messages.h"

void store_vec3(vec3 v, double out[3]) {
    out[0] = v.x;
    out[1] = v.y;
    out[2] = v.z;
}

static int flags_of(unsigned events) {
    int late = events & EVENT_LATE ? TROCAR_NEEDLE_WRENCH_T_LATE_WORKER : 0;
    int unstable = events & EVENT_UNSTABLE ? TROCAR_NEEDLE_WRENCH_T_UNSTABLE : 0;
    return late | unstable;
}

trocar_needle_wrench_t wrench_message(const insertion_wrench *wrench) {
    trocar_needle_wrench_t m = {.depth = wrench->depth, .contacts = wrench->contacts, .events = (int32_t)wrench->events,
                                .membrane = wrench->membrane, .flags = flags_of(wrench->events)};
    store_vec3(wrench->force, m.force);
    store_vec3(wrench->torque, m.torque);
    store_vec3(wrench->force, m.raw_force);
    store_vec3(wrench->torque, m.raw_torque);
    return m;
}
