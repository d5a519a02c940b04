/* Rate control of the needle, from a web page or by deflecting a device: turns commanded speeds into a motion of the base within limits, like a motorised
   needle holder. Uses no threads and no clock; the time step is passed in. */
#ifndef TROCAR_RATE_CONTROL_H
#define TROCAR_RATE_CONTROL_H

#include <stdbool.h>

#include "base/vec.h"

/* Commanded speeds, each as a fraction (-1 to 1) of its maximum. */
typedef struct {
    double right, up, forward;  /* along x, y and z of the home pose; if `along_needle` is true, forward is along the needle */
    double pitch, yaw, roll;    /* about x and y of the home pose, and about the needle's axis */
} rate_control_command;

typedef struct {
    double max_speed;           /* m/s along the needle's axis; sideways, half of it */
    double max_turn_rate;       /* rad/s */
    double ramp;                /* s, from rest to full speed */
    double max_sideways;        /* m, farthest from home along its x and y axes */
    double max_back, max_forward; /* m, farthest from home along its z axis */
    double max_tilt;            /* rad, largest angle between the needle and its direction at home */
    bool along_needle;          /* forward is along the needle, which may be tilted, not along z of the home pose */
} rate_control_limits;

typedef struct {
    pose home;
    pose base;
    vec3 velocity, turn;        /* m/s and rad/s, in the home pose's frame; turn.z is the rate of roll about the needle's axis */
} rate_control_state;

/* Returns the default limits for a needle of this length (m). */
rate_control_limits rate_control_defaults(double needle_length);

/* Starts with the needle at rest at `base`. */
void rate_control_begin(rate_control_state *d, pose home, pose base);

/* Advances the base by dt (s). Command components that are not finite count as 0; the others are clamped to -1 to 1. Speeds are ramped, and the base stops at
   the limits of its workspace. */
void rate_control_step(rate_control_state *d, const rate_control_limits *limits, rate_control_command command, double dt);

#endif
