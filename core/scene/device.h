/* Limits of haptic devices, which the server enforces, and a list of known devices. */
#ifndef TROCAR_DEVICE_H
#define TROCAR_DEVICE_H

#include <stdbool.h>

#include "trocar.h"

typedef trocar_device_limits device_limits;

device_limits device_defaults(void);

/* Names of the known devices, terminated by NULL. */
extern const char *const device_profiles[];

/* Sets the limits of force and torque, their rates, and the stiffness to those of a device. Returns false if the name is unknown. For a device without
   torque, the torque limits are left unchanged. Sources: meshes/PARAMETERS.md. */
bool device_use_profile(const char *name, device_limits *limits);

#endif
