/* Rate control of the needle by a page or a deflected device: converts commanded speeds into motion of the base within limits, like a motorised
   needle holder. No threads, no clock: time is an argument. */
#ifndef TROCAR_RATE_CONTROL_H
#define TROCAR_RATE_CONTROL_H

#include <stdbool.h>

#include "base/vec.h"

/* Commanded speeds, each as a fraction -1 .. 1 of its limit. */
typedef struct {
    double right, up, forward;  /* along x, y and z of the home pose; with `along_needle`, forward is along the needle */
    double pitch, yaw, roll;    /* about x and y of the home pose, and about the needle's axis */
} rate_control_command;

typedef struct {
    double max_speed;           /* m/s along the axis; the limit sideways is half of it */
    double max_turn_rate;       /* rad/s */
    double ramp;                /* s from rest to full speed */
    double max_sideways;        /* m from home along its x and y axes */
    double max_back, max_forward; /* m from home along its z axis */
    double max_tilt;            /* rad between the needle and its direction at home */
    bool along_needle;          /* forward is along the needle's axis, which may be tilted, instead of z of the home pose */
} rate_control_limits;

typedef struct {
    pose home;
    pose base;
    vec3 velocity, turn;        /* m/s and rad/s, in the home pose's frame; turn.z is the speed of the roll about the needle's axis */
} rate_control_state;

/* Returns the limits for a needle of this length, m. */
rate_control_limits rate_control_defaults(double needle_length);

/* Starts with the needle at rest at `base`. */
void rate_control_begin(rate_control_state *d, pose home, pose base);

/* Advances the base by dt (s). Components of the command that are not finite count as 0, others are clamped to -1 .. 1; speeds
   are ramped; the base stops at the limits of its workspace. */
void rate_control_step(rate_control_state *d, const rate_control_limits *limits, rate_control_command command, double dt);

#endif
