#include "scene/device.h"

#include <math.h>
#include <string.h>

device_limits device_defaults(void) {
    return (device_limits){.max_stiffness = 400.0, .max_force = 20.0, .max_torque = 1.0, .max_force_rate = 2000.0, .max_torque_rate = 100.0,
                           .max_speed = 2.0, .max_turn_rate = 20.0, .hold_time = 0.01, .ramp_time = 0.1,
                           .mass = 0.1, .delay = 2e-3};
}

device_mapping device_mapping_defaults(void) { return (device_mapping){.workspace = {NAN, NAN, NAN}, .scale = 1.0, .force_scale = 1.0}; }

const char *const device_profiles[] = {"touch", "touch-x", "premium-1.5-6dof", "falcon", "omega.3", "delta.6", "sigma.7", NULL};

/* What each device can render, in the order of device_profiles: force (N), torque (N m; 0 if none) and the stiffness of a virtual wall (N/m). Also its
   workspace (m). */
static const struct { double force, torque, stiffness; vec3 workspace; } RENDERED[] = {
    {3.3, 0.0, 400.0, {0.16, 0.12, 0.07}}, {7.9, 0.0, 1000.0, {0.16, 0.12, 0.12}}, {8.5, 0.188, 800.0, {0.381, 0.267, 0.191}},
    {8.0, 0.0, 3000.0, {0.08, 0.08, 0.08}}, {12.0, 0.0, 5000.0, {0.15, 0.15, 0.15}}, {20.0, 0.2, 5000.0, {0.3, 0.3, 0.3}}, {12.0, 0.2, 4000.0, {0.15, 0.15, 0.15}},
};
_Static_assert(sizeof RENDERED / sizeof *RENDERED == sizeof device_profiles / sizeof *device_profiles - 1, "a row for each name");

/* s, time in which the force may rise from zero to its maximum. Too short for people to notice. At 5 ms, the force of a hard impact would lag so far behind
   that a light hand would start to oscillate (tests/unit/server/test_virtual_coupling.c). */
static const double FULL_SLEW = 3e-3;

/* Returns a profile's index, or -1 if there is no such profile. */
static int find_profile(const char *name) {
    for (int i = 0; device_profiles[i]; i++)
        if (strcmp(device_profiles[i], name) == 0) return i;
    return -1;
}

bool device_use_profile(const char *name, device_limits *limits) {
    int i = find_profile(name);
    if (i < 0) return false;
    limits->max_stiffness = RENDERED[i].stiffness;
    limits->max_force = RENDERED[i].force;
    limits->max_force_rate = RENDERED[i].force / FULL_SLEW;
    if (RENDERED[i].torque == 0.0) return true;
    limits->max_torque = RENDERED[i].torque;
    limits->max_torque_rate = RENDERED[i].torque / FULL_SLEW;
    return true;
}

vec3 device_workspace(const char *name) {
    int i = find_profile(name);
    return i < 0 ? device_mapping_defaults().workspace : RENDERED[i].workspace;
}

device_limits device_limits_at_needle(const device_limits *handle, const device_mapping *mapping) {
    device_limits needle = *handle;
    double motion = mapping->scale, force = mapping->force_scale;
    needle.mass /= motion * force;
    needle.max_stiffness /= motion * force;
    needle.max_force /= force;
    needle.max_force_rate /= force;
    needle.max_torque /= force;
    needle.max_torque_rate /= force;
    needle.max_speed *= motion;
    return needle;
}
