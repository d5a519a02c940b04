/* What a haptic device renders: the limits that the server keeps, and known devices by name. */
#ifndef TROCAR_DEVICE_H
#define TROCAR_DEVICE_H

#include <stdbool.h>

typedef struct {
    double max_stiffness;    /* N/m, of the virtual coupling; INFINITY: no coupling, the needle is held rigidly */
    double max_force;        /* N */
    double max_torque;       /* N m */
    double max_force_rate;   /* N/s */
    double max_torque_rate;  /* N m/s */
    double max_speed;        /* m/s, of the base point */
    double max_turn_rate;    /* rad/s */
    double hold_time;        /* s without a pose before the wrench is ramped down */
    double ramp_time;        /* s from the full wrench to none, and back */
} device_limits;

device_limits device_defaults(void);

/* Names of the known devices, ended by NULL. */
extern const char *const device_profiles[];

/* Sets the limits on force and torque, their rates and the stiffness to those of a device; false if the name is unknown. A
   device that renders no torque leaves the limits on torque alone. Sources: meshes/PARAMETERS.md. */
bool device_use_profile(const char *name, device_limits *limits);

#endif
