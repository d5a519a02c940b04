#include "device/hand.h"

/* Computes cos(w t) and sin(w t)/w for the damped frequency w or, if w^2 is negative (overdamped), cosh and sinh instead. */
static void oscillation(double squared_frequency, double t, double *cosine, double *sine) {
    double w = sqrt(fabs(squared_frequency));
    if (w * t < 1e-6) {
        *cosine = 1.0 - 0.5 * squared_frequency * t * t;
        *sine = t;
    } else if (squared_frequency > 0) {
        *cosine = cos(w * t);
        *sine = sin(w * t) / w;
    } else {
        *cosine = cosh(w * t);
        *sine = sinh(w * t) / w;
    }
}

void hand_step(hand *h, vec3 target, vec3 force, double dt) {
    double decay = 0.5 * h->damping / h->mass, stiffness = h->stiffness / h->mass, cosine, sine;
    oscillation(stiffness - decay * decay, dt, &cosine, &sine);
    double envelope = exp(-decay * dt);

    vec3 rest = v3_axpy(1.0 / h->stiffness, force, target);
    vec3 x = v3_sub(h->position, rest), v = h->velocity;
    vec3 moved = v3_add(v3_scale(cosine + decay * sine, x), v3_scale(sine, v));
    h->velocity = v3_scale(envelope, v3_sub(v3_scale(cosine - decay * sine, v), v3_scale(stiffness * sine, x)));
    h->position = v3_axpy(envelope, moved, rest);
}
