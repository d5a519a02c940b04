/* Measures a device's response to forces: the round trip from a force to the positions that show it, and the mass that a person holds. A small force
   at three frequencies moves the device; a mass, a damper and a spring behind a delay are fitted to its motion at these frequencies. No clock: time
   is an argument. */
#ifndef TROCAR_HAPLY_DEVICE_RESPONSE_H
#define TROCAR_HAPLY_DEVICE_RESPONSE_H

#include <stdbool.h>

enum { RESPONSE_FREQUENCIES = 3 };

typedef struct {
    double amplitude;        /* N, amplitude of each frequency */
    double begin;            /* s */
    struct { double time, value; bool known; } force, position; /* newest values: N and m, along one direction */
    double forces[RESPONSE_FREQUENCIES][2], positions[RESPONSE_FREQUENCIES][2]; /* Fourier integrals: N s and m s, cosine and sine */
} device_response;

typedef struct {
    double delay;            /* s, round trip */
    double mass;             /* kg, mass of device and hand */
    double damping;          /* N s/m */
    double stiffness;        /* N/m, stiffness of the hand */
    double misfit;           /* relative misfit of the motion */
} response_model;

/* Starts a measurement in which the force is at most `greatest` (N). */
void response_begin(device_response *r, double greatest, double now);

/* Returns the force (N) to render at the time `now`; zero after the measurement. */
double response_force(device_response *r, double now);

/* Takes the device's position (m) along the force, read at the time `now`. */
void response_add(device_response *r, double now, double position);

bool response_is_over(const device_response *r, double now);

/* Stores the result in `model`. Returns false if the device did not move like a mass in a hand: it is blocked, out of reach, or moved too much. */
bool response_fit(const device_response *r, response_model *model);

#endif
