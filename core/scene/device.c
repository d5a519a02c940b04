#include "scene/device.h"

#include <math.h>
#include <string.h>

device_limits device_defaults(void) {
    return (device_limits){.max_stiffness = 400.0, .max_force = 20.0, .max_torque = 1.0, .max_force_rate = 2000.0, .max_torque_rate = 100.0,
                           .max_speed = 2.0, .max_turn_rate = 20.0, .hold_time = 0.01, .ramp_time = 0.1,
                           .mass = 0.1, .delay = 2e-3};
}

const char *const device_profiles[] = {"touch", "touch-x", "premium-1.5-6dof", "falcon", "omega.3", "delta.6", "sigma.7", NULL};

/* Force (N), torque (N m; 0 if there is none) and stiffness of a virtual wall (N/m) that each device can render, in the order of device_profiles. */
static const struct { double force, torque, stiffness; } RENDERED[] = {
    {3.3, 0.0, 400.0}, {7.9, 0.0, 1000.0}, {8.5, 0.188, 800.0}, {8.0, 0.0, 3000.0}, {12.0, 0.0, 5000.0}, {20.0, 0.2, 5000.0}, {12.0, 0.2, 4000.0},
};
_Static_assert(sizeof RENDERED / sizeof *RENDERED == sizeof device_profiles / sizeof *device_profiles - 1, "a row for each name");

/* Time (s) from zero to full force. It is too short for people to perceive. At 5 ms, the force of a hard impact would lag far enough behind the hand to drive
   a light hand (tests/unit/server/test_virtual_coupling.c). */
static const double FULL_SLEW = 3e-3;

bool device_use_profile(const char *name, device_limits *limits) {
    for (int i = 0; device_profiles[i]; i++) {
        if (strcmp(device_profiles[i], name) != 0) continue;
        limits->max_stiffness = RENDERED[i].stiffness;
        limits->max_force = RENDERED[i].force;
        limits->max_force_rate = RENDERED[i].force / FULL_SLEW;
        if (RENDERED[i].torque == 0.0) return true;
        limits->max_torque = RENDERED[i].torque;
        limits->max_torque_rate = RENDERED[i].torque / FULL_SLEW;
        return true;
    }
    return false;
}
