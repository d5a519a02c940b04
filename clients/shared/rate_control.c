#include "shared/rate_control.h"

rate_control_limits rate_control_defaults(double needle_length) {
    return (rate_control_limits){.max_speed = 0.04, .max_turn_rate = 0.5, .ramp = 0.15, .max_sideways = 0.04, .max_back = 0.03,
                          .max_forward = 0.75 * needle_length, .max_tilt = 0.35};
}

void rate_control_begin(rate_control_state *d, pose home, pose base) { *d = (rate_control_state){.home = home, .base = base}; }

static double share(double asked) { return isfinite(asked) ? fmax(-1, fmin(1, asked)) : 0; }

/* Moves `value` towards `wanted`, by at most `step`. */
static double approach(double value, double wanted, double step) { return value + fmax(-step, fmin(step, wanted - value)); }

static vec3 approach_vector(vec3 value, vec3 wanted, vec3 step) {
    return v3(approach(value.x, wanted.x, step.x), approach(value.y, wanted.y, step.y), approach(value.z, wanted.z, step.z));
}

/* Advances a coordinate. If that would take it beyond `low` or `high`, leaves it and sets the speed to zero. A coordinate that is already outside can still
   move back. */
static double move(double from, double *speed, double dt, double low, double high) {
    double to = from + *speed * dt;
    bool leaves = *speed > 0 ? to > high : to < low;
    if (!leaves) return to;
    *speed = 0;
    return from;
}

/* Advances the position along `axis`, in the home pose's frame. If any coordinate would leave its limits, leaves the position and sets the speed to zero. */
static vec3 move_along(vec3 x, vec3 axis, double *speed, double dt, const rate_control_limits *l) {
    vec3 asked = v3_scale(*speed, axis), v = asked;
    vec3 moved = v3(move(x.x, &v.x, dt, -l->max_sideways, l->max_sideways), move(x.y, &v.y, dt, -l->max_sideways, l->max_sideways),
                    move(x.z, &v.z, dt, -l->max_back, l->max_forward));
    if (v.x == asked.x && v.y == asked.y && v.z == asked.z) return moved;
    *speed = 0;
    return x;
}

/* Returns the next position of the base. The limits apply in the frame of the home pose, with the home position as origin. */
static vec3 move_base(rate_control_state *d, const rate_control_limits *l, double dt) {
    quat home = d->home.orientation;
    vec3 axis = l->along_needle ? q_rotate(q_conjugate(home), q_axis(d->base.orientation)) : v3(0, 0, 1);
    vec3 x = q_rotate(q_conjugate(home), v3_sub(d->base.position, d->home.position));
    vec3 moved = v3(move(x.x, &d->velocity.x, dt, -l->max_sideways, l->max_sideways),
                    move(x.y, &d->velocity.y, dt, -l->max_sideways, l->max_sideways), x.z);
    moved = move_along(moved, axis, &d->velocity.z, dt, l);
    return v3_add(d->base.position, q_rotate(home, v3_sub(moved, x))); /* if nothing moves, the position stays exactly the same */
}

static double tilt_of(quat q, quat home) {
    double along = v3_dot(q_axis(q), q_axis(home));
    return acos(fmax(-1, fmin(1, along)));
}

/* Tilts the base in the frame of the home pose, and rolls it in the needle's. Rejects a tilt beyond the limit, unless the needle was tilted even farther. */
static quat turn_base(rate_control_state *d, const rate_control_limits *l, double dt) {
    quat q = d->base.orientation, home = d->home.orientation;
    quat tilted = q_multiply(q_exp(q_rotate(home, v3(d->turn.x * dt, d->turn.y * dt, 0))), q);
    if (tilt_of(tilted, home) <= fmax(l->max_tilt, tilt_of(q, home))) q = tilted;
    else d->turn.x = d->turn.y = 0;
    return q_unit(q_multiply(q, q_exp(v3(0, 0, d->turn.z * dt))));
}

void rate_control_step(rate_control_state *d, const rate_control_limits *limits, rate_control_command c, double dt) {
    double along = limits->max_speed, aside = 0.5 * limits->max_speed, turning = limits->max_turn_rate, part = dt / limits->ramp;
    vec3 velocity = v3(aside * share(c.right), aside * share(c.up), along * share(c.forward));
    vec3 turn = v3(turning * share(c.pitch), turning * share(c.yaw), 2 * turning * share(c.roll));
    d->velocity = approach_vector(d->velocity, velocity, v3(aside * part, aside * part, along * part));
    d->turn = approach_vector(d->turn, turn, v3(turning * part, turning * part, 2 * turning * part));
    d->base.position = move_base(d, limits, dt);
    d->base.orientation = turn_base(d, limits, dt);
}
