#include "simulated_device.h"

static const double LONGEST_STEP = 0.25e-3; /* s, longest time for which the hand's target is held constant */

void device_init(simulated_device *d, const device_properties *properties, vec3 position, double now) {
    *d = (simulated_device){.properties = *properties, .time = now - properties->delay, .target = position};
    d->hand = (hand){.mass = properties->mass, .damping = properties->damping, .stiffness = properties->stiffness, .position = position};
    device_watch(d);
}

static vec3 pushed_to(const simulated_device *d, double t) { return v3_axpy(fmax(0.0, fmin(t, d->end) - d->begin), d->velocity, d->target); }

static vec3 target_at(const simulated_device *d, double t) {
    double phase = t > d->shaken_from && t < d->shaken_until ? 2.0 * M_PI * d->frequency * (t - d->shaken_from) : 0.0;
    return v3_axpy(sin(phase), d->amplitude, pushed_to(d, t));
}

void device_push(simulated_device *d, vec3 velocity, double begin, double end) {
    d->target = pushed_to(d, begin);
    d->velocity = velocity;
    d->begin = begin;
    d->end = end;
}

void device_shake(simulated_device *d, vec3 amplitude, double frequency, double begin, double end) {
    d->amplitude = amplitude;
    d->frequency = frequency;
    d->shaken_from = begin;
    d->shaken_until = end;
}

size_t device_size(void) { return sizeof(simulated_device); }

double device_swing(const simulated_device *d) { return v3_norm(v3_sub(d->highest, d->lowest)); }

void device_watch(simulated_device *d) { d->lowest = d->highest = d->hand.position; }

static vec3 lower(vec3 a, vec3 b) { return v3(fmin(a.x, b.x), fmin(a.y, b.y), fmin(a.z, b.z)); }
static vec3 higher(vec3 a, vec3 b) { return v3(fmax(a.x, b.x), fmax(a.y, b.y), fmax(a.z, b.z)); }

/* Returns the last time at or before t at which the device's loop runs. */
static double sample_before(const simulated_device *d, double t) {
    double period = d->properties.period;
    return period > 0.0 ? period * floor(t / period + 1e-9) : t;
}

static double sample_after(const simulated_device *d, double t) {
    double period = d->properties.period;
    return period > 0.0 ? period * ceil(t / period - 1e-9) : t;
}

/* Applies the forces that are due, then advances the hand by at most LONGEST_STEP, but not beyond t or the time at which the next force is due. */
static void advance(simulated_device *d, double t) {
    while (d->applied < d->sent && d->forces[d->applied % DEVICE_FORCES].due <= d->time) d->force = d->forces[d->applied++ % DEVICE_FORCES].force;
    double next = fmin(t, d->time + LONGEST_STEP);
    if (d->applied < d->sent) next = fmin(next, d->forces[d->applied % DEVICE_FORCES].due);
    hand_step(&d->hand, target_at(d, next), d->force, next - d->time);
    d->time = next;
    d->lowest = lower(d->lowest, d->hand.position);
    d->highest = higher(d->highest, d->hand.position);
}

void device_apply(simulated_device *d, double now, vec3 force) {
    if (d->sent - d->applied >= DEVICE_FORCES) d->applied = d->sent - DEVICE_FORCES + 1; /* full because nobody reads positions: drop the oldest force */
    d->forces[d->sent % DEVICE_FORCES].due = sample_after(d, now + d->properties.delay);
    d->forces[d->sent % DEVICE_FORCES].force = force;
    d->sent++;
}

static double rounded(double x, double resolution) { return resolution > 0.0 ? resolution * floor(x / resolution + 0.5) : x; }

vec3 device_read(simulated_device *d, double now) {
    double t = sample_before(d, now - d->properties.delay), resolution = d->properties.resolution;
    while (d->time < t) advance(d, t);
    vec3 p = d->hand.position;
    return v3(rounded(p.x, resolution), rounded(p.y, resolution), rounded(p.z, resolution));
}
