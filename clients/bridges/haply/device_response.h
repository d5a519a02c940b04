/* Measures how a device responds to forces: the round-trip time from sending a force to receiving the positions that it causes, and the mass of the
   device together with the hand that holds it. A small force with three frequency components moves the device, and a model of a mass, a damper and a
   spring behind a delay is fitted to the motion at these frequencies. The code reads no clock: time is an argument. */
#ifndef TROCAR_HAPLY_DEVICE_RESPONSE_H
#define TROCAR_HAPLY_DEVICE_RESPONSE_H

#include <stdbool.h>

enum { RESPONSE_FREQUENCIES = 3 };

typedef struct {
    double amplitude;        /* N, amplitude of the force at each frequency */
    double begin;            /* s */
    struct { double time, value; bool known; } force, position; /* newest force (N) and position (m), along the same direction */
    double forces[RESPONSE_FREQUENCIES][2], positions[RESPONSE_FREQUENCIES][2]; /* Fourier integrals of force (N s) and position (m s): cosine and sine parts */
} device_response;

typedef struct {
    double delay;            /* s, round trip */
    double mass;             /* kg, combined mass of device and hand */
    double damping;          /* N s/m */
    double stiffness;        /* N/m, stiffness of the hand */
    double misfit;           /* relative misfit between measured and modelled motion */
} response_model;

/* Starts a measurement in which the force never exceeds `greatest` (N). */
void response_begin(device_response *r, double greatest, double now);

/* Returns the force (N) to render at the time `now`; zero after the measurement. */
double response_force(device_response *r, double now);

/* Adds the device's position (m) along the direction of the force, as read at the time `now`. */
void response_add(device_response *r, double now, double position);

bool response_is_over(const device_response *r, double now);

/* Stores the result in `model`. Returns false if the device did not move like a mass held in a hand, because it was blocked, out of reach, or moved
   too far. */
bool response_fit(const device_response *r, response_model *model);

#endif
