#include "passivity.h"

static const double SMOOTHING = 2e-3;        /* s, smoothing of the velocity: a step of 0.05 mm in 1 ms is 0.05 m/s */

/* A mass m braked by a force -b v(t - T) is stable for b T / m < pi / 2. With this value, even a third of the mass is still stable. */
double passivity_damping(double mass, double delay) { return mass / (2.0 * (delay + SMOOTHING)); }

/* Adds the work done on the device by the force that acted during its last motion. */
static void observe(passivity *p, vec3 position) {
    vec3 way = p->count > 0 ? v3_sub(position, p->position) : v3(0, 0, 0);
    long acting = p->count - p->delay;
    if (acting >= 0) p->energy += v3_dot(p->forces[acting % PASSIVITY_DELAY], way);
    p->most = fmax(p->most, p->energy);
    p->position = position;
    p->velocity = v3_axpy(p->period / (p->period + SMOOTHING), v3_sub(v3_scale(1.0 / p->period, way), p->velocity), p->velocity);
}

vec3 passivity_next(passivity *p, vec3 position, vec3 wanted) {
    observe(p, position);
    double square = v3_dot(p->velocity, p->velocity), damping = 0.0;
    if (p->energy > 0.0 && square > 0.0) damping = fmin(p->most_damping, p->energy / (square * p->period));
    vec3 force = v3_axpy(-damping, p->velocity, wanted);
    force = v3_scale(p->max_force / fmax(p->max_force, v3_norm(force)), force);
    p->forces[p->count++ % PASSIVITY_DELAY] = force;
    return force;
}
