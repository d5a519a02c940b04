/* Measures how a device responds to forces: the round-trip delay between sending a force and receiving the positions that result, and the combined mass of
   the device and the hand that holds it. The device is moved by a small force with three frequency components, and a mass-spring-damper model with a
   delay is fitted to its motion at these frequencies. The code does not read the clock; the time is passed in. */
#ifndef TROCAR_HAPLY_DEVICE_RESPONSE_H
#define TROCAR_HAPLY_DEVICE_RESPONSE_H

#include <stdbool.h>

enum { RESPONSE_FREQUENCIES = 3 };

typedef struct {
    double amplitude;        /* N, amplitude of the force at each frequency */
    double begin;            /* s */
    struct { double time, value; bool known; } force, position; /* newest force (N) and position (m) along the measuring direction */
    double forces[RESPONSE_FREQUENCIES][2], positions[RESPONSE_FREQUENCIES][2]; /* Fourier integrals of force (N s) and position (m s): cosine and sine parts */
} device_response;

typedef struct {
    double delay;            /* s, round trip */
    double mass;             /* kg, combined mass of device and hand */
    double damping;          /* N s/m */
    double stiffness;        /* N/m, stiffness of the hand */
    double misfit;           /* relative difference between measured and modelled motion */
} response_model;

/* Starts a measurement in which the force never exceeds `greatest` (N). */
void response_begin(device_response *r, double greatest, double now);

/* Returns the force (N) to render at the time `now`; zero after the measurement. */
double response_force(device_response *r, double now);

/* Adds a sample: the device's position (m) along the direction of the force at time `now`. */
void response_add(device_response *r, double now, double position);

bool response_is_over(const device_response *r, double now);

/* Fits the model. Returns false if the device did not move like a mass held in a hand, because it was blocked, out of reach, or moved too far. */
bool response_fit(const device_response *r, response_model *model);

#endif
