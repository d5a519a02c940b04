#include "device_response.h"

#include <complex.h>
#include <math.h>

/* Hz: above the hand's tremor (8 to 12 Hz) and voluntary motion, but low enough for the device to move by a few hundredths of a millimetre. */
static const double FREQUENCIES[RESPONSE_FREQUENCIES] = {14, 23, 37};
static const double SETTLING = 0.5;                  /* s, settling time before the measurement */
static const double DURATION = 4.0;                  /* s, duration of the measurement */
static const double LONGEST_STEP = 1e-3;             /* s, largest integration step */
static const double LONGEST_DELAY = 0.06;            /* s, longest round-trip delay tried: longer than one period of the second-lowest frequency, shorter
                                                        than one period of the lowest */
static const double MOST_MISFIT = 0.2;
static const double LEAST_MOTION = 1e-6;             /* m: motion with a smaller amplitude is regarded as noise */

void response_begin(device_response *r, double greatest, double now) {
    *r = (device_response){.amplitude = greatest / RESPONSE_FREQUENCIES, .begin = now + SETTLING};
}

bool response_is_over(const device_response *r, double now) { return now > r->begin + DURATION; }

/* Adds to the sums the integral of value * e^(-i w t) over a short interval around `middle`, times a Hann window that suppresses the hand's drift. */
static void integrate_step(const device_response *r, double sums[][2], double value, double middle, double length) {
    double t = middle - r->begin;
    if (t < 0.0 || t > DURATION) return;
    double weight = value * length * (1.0 - cos(2.0 * M_PI * t / DURATION));
    for (int i = 0; i < RESPONSE_FREQUENCIES; i++) {
        sums[i][0] += weight * cos(2.0 * M_PI * FREQUENCIES[i] * t);
        sums[i][1] -= weight * sin(2.0 * M_PI * FREQUENCIES[i] * t);
    }
}

/* Like integrate_step, but for an interval of any length over which the value changes linearly. */
static void integrate(const device_response *r, double sums[][2], double from, double first, double to, double last) {
    int steps = (int)ceil((to - from) / LONGEST_STEP);
    double length = (to - from) / steps;
    for (int i = 0; i < steps; i++) {
        double part = (i + 0.5) / steps;
        integrate_step(r, sums, first + part * (last - first), from + part * (to - from), length);
    }
}

double response_force(device_response *r, double now) {
    if (r->force.known) integrate(r, r->forces, r->force.time, r->force.value, now, r->force.value);
    double force = 0.0, t = now - (r->begin - SETTLING), rise = fmin(1.0, t / SETTLING);
    for (int i = 0; i < RESPONSE_FREQUENCIES; i++) force += r->amplitude * rise * sin(2.0 * M_PI * FREQUENCIES[i] * t);
    if (response_is_over(r, now)) force = 0.0;
    r->force.time = now;
    r->force.value = force;
    r->force.known = true;
    return force;
}

void response_add(device_response *r, double now, double position) {
    if (r->position.known) integrate(r, r->positions, r->position.time, r->position.value, now, position);
    r->position.time = now;
    r->position.value = position;
    r->position.known = true;
}

/* Fits mass, damping and stiffness to the impedances (N/m), assuming a given delay. Returns the squared relative misfit. */
static double fit(const double complex *impedances, double delay, response_model *model) {
    double s0 = 0, s1 = 0, s2 = 0, b0 = 0, b1 = 0, d0 = 0, d1 = 0, misfit = 0;
    for (int i = 0; i < RESPONSE_FREQUENCIES; i++) { /* weighted least squares fit of Re z = k - m w^2, Im z = c w */
        double w = 2.0 * M_PI * FREQUENCIES[i], weight = 1.0 / (cabs(impedances[i]) * cabs(impedances[i]));
        double complex z = impedances[i] * cexp(-I * w * delay);
        s0 += weight;
        s1 += weight * w * w;
        s2 += weight * w * w * w * w;
        b0 += weight * creal(z);
        b1 += weight * creal(z) * w * w;
        d0 += weight * w * w;
        d1 += weight * cimag(z) * w;
    }
    double determinant = s0 * s2 - s1 * s1;
    *model = (response_model){.delay = delay, .mass = (s1 * b0 - s0 * b1) / determinant, .stiffness = (s2 * b0 - s1 * b1) / determinant,
                              .damping = fmax(0.0, d1 / d0)};
    if (!(model->stiffness > 0.0)) model->stiffness = 0.0, model->mass = -b1 / s2;
    for (int i = 0; i < RESPONSE_FREQUENCIES; i++) {
        double w = 2.0 * M_PI * FREQUENCIES[i];
        double complex z = impedances[i] * cexp(-I * w * delay), off = z - (model->stiffness - model->mass * w * w + I * model->damping * w);
        misfit += cabs(off) * cabs(off) / (cabs(z) * cabs(z));
    }
    model->misfit = sqrt(misfit / RESPONSE_FREQUENCIES);
    return misfit;
}

bool response_fit(const device_response *r, response_model *model) {
    double complex impedances[RESPONSE_FREQUENCIES];
    for (int i = 0; i < RESPONSE_FREQUENCIES; i++) {
        impedances[i] = (r->forces[i][0] + I * r->forces[i][1]) / (r->positions[i][0] + I * r->positions[i][1]);
        if (!(hypot(r->positions[i][0], r->positions[i][1]) > 0.5 * DURATION * LEAST_MOTION) || !(cabs(impedances[i]) > 0.0)) return false;
    }
    static const double STEP = 1e-4; /* s */
    double least = INFINITY;
    for (int i = 0; i <= (int)(LONGEST_DELAY / STEP); i++) {
        response_model tried;
        double misfit = fit(impedances, STEP * i, &tried);
        if (!(misfit < least) || !(tried.mass > 0.0)) continue;
        least = misfit;
        *model = tried;
    }
    return isfinite(least) && model->misfit < MOST_MISFIT;
}
