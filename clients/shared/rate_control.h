/* Rate control of the needle from a web page or a deflected device: converts commanded speeds into a motion of the base within limits, like a motorised
   needle holder. The code uses no threads and no clock: time is an argument. */
#ifndef TROCAR_RATE_CONTROL_H
#define TROCAR_RATE_CONTROL_H

#include <stdbool.h>

#include "base/vec.h"

/* Commanded speeds, each given as a fraction (-1 to 1) of its maximum. */
typedef struct {
    double right, up, forward;  /* speeds along x, y and z of the home pose; if `along_needle` is true, forward is along the needle */
    double pitch, yaw, roll;    /* rates of rotation about x and y of the home pose, and about the needle's axis */
} rate_control_command;

typedef struct {
    double max_speed;           /* m/s along the needle's axis; the maximum sideways speed is half of this */
    double max_turn_rate;       /* rad/s */
    double ramp;                /* s, time from rest to full speed */
    double max_sideways;        /* m, maximum distance from home along its x and y axes */
    double max_back, max_forward; /* m, maximum distances from home along its z axis */
    double max_tilt;            /* rad, maximum angle between the needle and its direction at home */
    bool along_needle;          /* forward is along the needle's axis, which may be tilted, instead of z of the home pose */
} rate_control_limits;

typedef struct {
    pose home;
    pose base;
    vec3 velocity, turn;        /* velocity (m/s) and angular velocity (rad/s) in the home pose's frame; turn.z is the rate of roll about the needle's axis */
} rate_control_state;

/* Returns the limits for a needle of this length, m. */
rate_control_limits rate_control_defaults(double needle_length);

/* Starts with the needle at rest at `base`. */
void rate_control_begin(rate_control_state *d, pose home, pose base);

/* Advances the base by dt (s). Components of the command that are not finite count as 0, and the others are clamped to the range -1 to 1; speeds are ramped;
   the base stops at the limits of its workspace. */
void rate_control_step(rate_control_state *d, const rate_control_limits *limits, rate_control_command command, double dt);

#endif
