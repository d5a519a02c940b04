#include "limiter.h"

static const double RAMP = 0.1;          /* s, duration of the ramp, as in trocar_client after an outage */
static const double LONGEST_PERIOD = 0.01; /* s: after a longer gap between calls, the rate limit still allows only the change for this time */

void limiter_cut(limiter *l) {
    l->gain = l->grip = 0;
    l->force = v3(0, 0, 0);
}

static vec3 shortened(vec3 v, double longest) {
    double length = v3_norm(v);
    return length > longest ? v3_scale(longest / length, v) : v;
}

static vec3 approach(limiter *l, vec3 wanted, double period) {
    vec3 step = shortened(v3_sub(shortened(wanted, l->max_force), l->force), l->max_rate * period);
    l->force = shortened(v3_add(l->force, step), l->max_force);
    return l->force;
}

void limiter_let_go(limiter *l) { l->grip = 0; }

vec3 limiter_next(limiter *l, vec3 felt, vec3 carried, double period) {
    double step = fmin(period, LONGEST_PERIOD), rise = step / RAMP;
    vec3 wanted = v3_axpy(fmin(1.0, l->grip + rise), felt, carried);
    if (!isfinite(v3_norm(wanted)) || !(period >= 0)) {
        limiter_cut(l);
        return l->force;
    }
    l->gain = fmin(1.0, l->gain + rise);
    l->grip = fmin(1.0, l->grip + rise);
    return approach(l, v3_scale(l->gain, wanted), step);
}
