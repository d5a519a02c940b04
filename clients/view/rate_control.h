/* A needle driven from a page: commanded speeds become the base's motion within limits, as a motorised holder would move it.
   No threads, no clock. */
#ifndef TROCAR_RATE_CONTROL_H
#define TROCAR_RATE_CONTROL_H

#include "base/vec.h"

/* What the page asks for, each within -1 .. 1 of the limit. */
typedef struct {
    double right, up, forward;  /* along world x, y and z: the template's axis is z */
    double pitch, yaw, roll;    /* about world x and y, and about the needle's axis */
} rate_control_command;

typedef struct {
    double max_speed;           /* m/s along the axis; sideways half of it */
    double max_turn_rate;       /* rad/s */
    double ramp;                /* s from rest to the full speed */
    double max_sideways;        /* m from home in x and y */
    double max_back, max_forward; /* m from home in z */
    double max_tilt;            /* rad between the needle and the template's axis */
} rate_control_limits;

typedef struct {
    pose home;                  /* needle along +z */
    pose base;
    vec3 velocity, turn;        /* m/s and rad/s, world frame; turn.z is the roll about the needle's axis */
} rate_control_state;

/* Limits for a needle of this length, m. */
rate_control_limits rate_control_defaults(double needle_length);

/* At rest at `base`. */
void rate_control_begin(rate_control_state *d, pose home, pose base);

/* Moves the base on by dt (s). What is not finite or beyond -1 .. 1 counts as 0 or is clamped; speeds follow the command by
   a ramp; at the edge of its space the base stops. */
void rate_control_step(rate_control_state *d, const rate_control_limits *limits, rate_control_command command, double dt);

#endif
