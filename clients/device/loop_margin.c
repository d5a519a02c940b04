#include "device/loop_margin.h"

#include <complex.h>
#include <stdbool.h>

#include "device/hand.h"

static const double OSCILLATIONS = 200;      /* points in the frequency scan per period of exp(-jwTd) */

static int scan_points(const haptic_loop *l) { return (int)(OSCILLATIONS * (l->delay + 2)); }

/* ---- passivity ------------------------------------------------------------------------------------------------------- */

/* Returns the damping needed to absorb the energy that the coupling generates at frequency w = `angle` / T. This is the expression in loop_required_damping,
   with H substituted. */
static double needed_at(const haptic_loop *l, double angle) {
    double spring = 0.5 * l->coupling_stiffness * l->period * sin((l->delay + 0.5) * angle) / sin(0.5 * angle);
    return spring - l->coupling_damping * cos((l->delay + 1) * angle);
}

double loop_required_damping(const haptic_loop *l, double *frequency) {
    int points = scan_points(l), most = 1;
    for (int i = 2; i <= points; i++)
        if (needed_at(l, M_PI * i / points) > needed_at(l, M_PI * most / points)) most = i;
    *frequency = 0.5 * most / (points * l->period);
    return fmax(0.0, needed_at(l, M_PI * most / points));
}

/* ---- stability ------------------------------------------------------------------------------------------------------- */

/* Discrete-time response of hand and device: their position and velocity one period after unit position, velocity or force. */
typedef struct { double position[3], velocity[3]; } transition;

static transition one_period(const haptic_loop *l) {
    transition t;
    for (int i = 0; i < 3; i++) {
        hand h = {.mass = l->mass, .damping = l->damping, .stiffness = l->stiffness, .position = v3(i == 0, 0, 0), .velocity = v3(i == 1, 0, 0)};
        hand_step(&h, v3(0, 0, 0), v3(i == 2, 0, 0), l->period);
        t.position[i] = h.position.x;
        t.velocity[i] = h.velocity.x;
    }
    return t;
}

/* Returns P(z) H(z) at z = exp(j angle). */
static double complex open_loop(const haptic_loop *l, const transition *t, double angle) {
    double complex z = cexp(I * angle);
    double complex determinant = (z - t->position[0]) * (z - t->velocity[1]) - t->position[1] * t->velocity[0];
    double complex response = ((z - t->velocity[1]) * t->position[2] + t->position[1] * t->velocity[2]) / determinant;
    double complex coupling = l->coupling_stiffness + l->coupling_damping * (1.0 - 1.0 / z) / l->period;
    return response * coupling * cexp(-I * angle * l->delay);
}

/* Finds by bisection the angle between `low` and `high` at which the imaginary part of the open-loop response changes sign. */
static double crossing(const haptic_loop *l, const transition *t, double low, double high) {
    bool sign = cimag(open_loop(l, t, low)) > 0.0;
    for (int i = 0; i < 60; i++) {
        double middle = 0.5 * (low + high);
        if ((cimag(open_loop(l, t, middle)) > 0.0) == sign) low = middle;
        else high = middle;
    }
    return 0.5 * (low + high);
}

static void keep_smallest(const haptic_loop *l, const transition *t, double angle, double *margin, double *frequency) {
    double response = creal(open_loop(l, t, angle));
    if (!(response < 0.0 && -1.0 / response < *margin)) return;
    *margin = -1.0 / response;
    *frequency = angle / (2.0 * M_PI * l->period);
}

static const double FIRST_ANGLE = 0.01;      /* where the scan starts, as a fraction of the angle at the natural frequency of hand and device */
static const double RATIO = 0.02;            /* largest relative step in the scan */

/* Damping in units of sqrt(k m), which is half the critical damping. Smaller values are raised to this one, because Nyquist's criterion requires the open
   loop's poles to lie inside the unit circle. */
static const double LEAST_DAMPING = 1e-6;

double loop_gain_margin(const haptic_loop *loop, double *frequency) {
    haptic_loop damped = *loop, *l = &damped;
    damped.damping = fmax(damped.damping, LEAST_DAMPING * sqrt(damped.stiffness * damped.mass));
    transition t = one_period(l);
    double step = M_PI / scan_points(l), natural = sqrt(l->stiffness / l->mass) * l->period, margin = INFINITY;
    *frequency = NAN;
    for (double low = fmin(step, FIRST_ANGLE * natural), high; low < M_PI; low = high) {
        high = fmin(M_PI, low + fmin(step, RATIO * low)); /* the relative step resolves even hands that are slow compared with the sampling rate */
        if ((cimag(open_loop(l, &t, low)) > 0.0) != (cimag(open_loop(l, &t, high)) > 0.0))
            keep_smallest(l, &t, crossing(l, &t, low, high), &margin, frequency);
    }
    keep_smallest(l, &t, M_PI, &margin, frequency);
    return margin;
}

/* ---- simulation ------------------------------------------------------------------------------------------------------ */

static const double DURATION = 5.0;          /* s */
static const double SPEED = 0.1, GAP = 1e-3, PUSH = 11e-3; /* m/s and m, as in tests/stability/stability_map.c */
static const double AT_REST = 0.5e-3;        /* m */
static const double LOST = 10.0;             /* m, amplitude beyond which the motion is certainly unstable */

/* A ring buffer of position readings. */
typedef struct {
    double positions[LOOP_MAX_DELAY + 2];
    long count;
} readings;

static double reading(const readings *r, long index) { return index < 0 ? r->positions[0] : r->positions[index % (LOOP_MAX_DELAY + 2)]; }

/* Stores a position reading, and returns the force computed from the reading taken `delay` periods before. */
static double next_force(readings *r, const haptic_loop *l, double position) {
    r->positions[r->count % (LOOP_MAX_DELAY + 2)] = position;
    long due = r->count++ - l->delay;
    double now = reading(r, due), before = reading(r, due - 1);
    return -(l->coupling_stiffness * now + l->coupling_damping * (now - before) / l->period);
}

/* True if the motion after an impulse dies out. */
static bool decays(const haptic_loop *l) {
    static readings r;
    hand h = {.mass = l->mass, .damping = l->damping, .stiffness = l->stiffness, .velocity = v3(SPEED, 0, 0)};
    double early = 0.0, late = 0.0;
    long steps = lround(DURATION / l->period);
    r.count = 0;
    for (long i = 0; i < steps && fabs(h.position.x) < LOST; i++) {
        hand_step(&h, v3(0, 0, 0), v3(next_force(&r, l, h.position.x), 0, 0), l->period);
        if (i > steps / 5 && i < 2 * steps / 5) early = fmax(early, fabs(h.position.x));
        if (i > 4 * steps / 5) late = fmax(late, fabs(h.position.x));
    }
    return fabs(h.position.x) < LOST && late <= early;
}

double loop_simulated_margin(const haptic_loop *l) {
    double low = 1e-6, high = 1e6;
    while (high > 1.001 * low) {
        haptic_loop scaled = *l;
        double factor = sqrt(low * high);
        scaled.coupling_stiffness *= factor;
        scaled.coupling_damping *= factor;
        if (decays(&scaled)) low = factor;
        else high = factor;
    }
    return sqrt(low * high);
}

static double limited(const loop_limits *limits, double force, double before, double period) {
    double change = limits->max_force_rate * period;
    force = fmax(-limits->max_force, fmin(0.0, force)); /* the wall only pushes */
    return fmax(before - change, fmin(before + change, force));
}

/* The hand comes to rest at the end of the last window in which its position varied by more than AT_REST. `WINDOW` is the length of a window. */
static const double WINDOW = 0.25;           /* s */

typedef struct { double lowest, highest, end, rest_time; } rest_watch;

static void watch_rest(rest_watch *w, double position, double time) {
    w->lowest = fmin(w->lowest, position);
    w->highest = fmax(w->highest, position);
    if (time < w->end) return;
    if (w->highest - w->lowest > AT_REST) w->rest_time = w->end;
    w->lowest = w->highest = position;
    w->end += WINDOW;
}

loop_push_result loop_push(const haptic_loop *l, const loop_limits *limits) {
    static readings r;
    hand h = {.mass = l->mass, .damping = l->damping, .stiffness = l->stiffness, .position = v3(-GAP, 0, 0)};
    loop_push_result result = {0};
    rest_watch watch = {INFINITY, -INFINITY, WINDOW, 0.0};
    double force = 0.0, energy = 0.0, pushing = PUSH / SPEED;
    r.count = 0;
    for (double time = -pushing; time < DURATION && fabs(h.position.x) < LOST; time += l->period) {
        double before = h.position.x, target = -GAP + SPEED * fmin(pushing, time + pushing);
        force = limited(limits, next_force(&r, l, limits->resolution * round(before / limits->resolution)), force, l->period);
        hand_step(&h, v3(target, 0, 0), v3(force, 0, 0), l->period);
        energy += force * (h.position.x - before);
        result.energy = fmax(result.energy, energy);
        result.force = fmax(result.force, -force);
        if (time >= 0.0) watch_rest(&watch, h.position.x, time);
    }
    bool rests = fabs(h.position.x) < LOST && watch.rest_time < DURATION - 2.0 * WINDOW;
    result.rest_time = rests ? watch.rest_time : INFINITY;
    return result;
}
