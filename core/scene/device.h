/* Limits of haptic devices, enforced by the server, and a list of known devices. */
#ifndef TROCAR_DEVICE_H
#define TROCAR_DEVICE_H

#include <stdbool.h>

#include "base/vec.h"
#include "trocar.h"

typedef trocar_device_limits device_limits;

/* How a bridge maps the motion of the hand to that of the needle, and the force on the needle to that on the hand. */
typedef struct {
    vec3 workspace;          /* m, width, height and depth in which the hand moves the device; NAN if unknown */
    double scale;            /* motion of the needle per motion of the hand */
    double force_scale;      /* force on the hand per force on the needle */
    int clutch;              /* 1: the bridge has a clutch, which lets the hand move while the needle stays where it is */
} device_mapping;

device_limits device_defaults(void);
device_mapping device_mapping_defaults(void);

/* Names of the known devices, terminated by NULL. */
extern const char *const device_profiles[];

/* Sets the limits of force and torque, their rates, and the stiffness to those of a device. Returns false if the name is unknown. For a device without
   torque, the torque limits are left unchanged. Sources: meshes/PARAMETERS.md. */
bool device_use_profile(const char *name, device_limits *limits);

/* Returns the workspace (m) of a known device: width, height and depth. */
vec3 device_workspace(const char *name);

/* Converts limits that hold at the handle to limits for the needle. At the needle, the hand moves `scale` times as far and pushes 1 / `force_scale` times
   as hard, so its mass and the stiffness are divided by scale force_scale. */
device_limits device_limits_at_needle(const device_limits *handle, const device_mapping *mapping);

#endif
