/* The limits of haptic devices, which the server enforces, and a list of known devices. */
#ifndef TROCAR_DEVICE_H
#define TROCAR_DEVICE_H

#include <stdbool.h>

#include "base/vec.h"
#include "trocar.h"

typedef trocar_device_limits device_limits;

/* How a bridge maps the hand's motion to the needle, and the force on the needle back to the hand. */
typedef struct {
    vec3 workspace;          /* m, width, height and depth of the space in which the hand can move the device; NAN if unknown */
    double scale;            /* how far the needle moves, relative to the hand */
    double force_scale;      /* force on the hand, relative to that on the needle */
    int clutch;              /* 1 if the bridge has a clutch, which lets the hand move without the needle */
} device_mapping;

device_limits device_defaults(void);
device_mapping device_mapping_defaults(void);

/* The names of the known devices, ending with NULL. */
extern const char *const device_profiles[];

/* Sets the limits on force, torque, their rates and the stiffness to those of a known device. Returns false if there is no device of this name. Leaves the
   torque limits as they are if the device renders no torque. Sources: meshes/PARAMETERS.md. */
bool device_use_profile(const char *name, device_limits *limits);

/* Returns the workspace (m) of a known device: its width, height and depth. */
vec3 device_workspace(const char *name);

/* Converts limits at the handle to limits at the needle. As felt at the needle, the hand moves `scale` times as far and pushes with 1 / `force_scale` of its
   force, so its mass and the stiffness are divided by scale force_scale. */
device_limits device_limits_at_needle(const device_limits *handle, const device_mapping *mapping);

#endif
