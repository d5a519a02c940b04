/* Measures a device's response to forces: the round trip from a force to the positions that show it, and the mass that a person holds. A small force
   at three frequencies moves the device, and its motion at these frequencies is fitted by a mass, a damper and a spring behind a delay. No clock:
   time is an argument. */
#ifndef TROCAR_HAPLY_DEVICE_RESPONSE_H
#define TROCAR_HAPLY_DEVICE_RESPONSE_H

#include <stdbool.h>

enum { RESPONSE_FREQUENCIES = 3 };

typedef struct {
    double amplitude;        /* N, of each frequency */
    double begin;            /* s */
    struct { double time, value; bool known; } force, position; /* the newest: N and m, along one direction */
    double forces[RESPONSE_FREQUENCIES][2], positions[RESPONSE_FREQUENCIES][2]; /* Fourier integrals: N s and m s, cosine and sine */
} device_response;

typedef struct {
    double delay;            /* s, round trip */
    double mass;             /* kg, of device and hand */
    double damping;          /* N s/m */
    double stiffness;        /* N/m, of the hand */
    double misfit;           /* of the motion, relative */
} response_model;

/* Starts; the force will be at most `greatest` (N). */
void response_begin(device_response *r, double greatest, double now);

/* The force (N) to render now. Zero when the time is over. */
double response_force(device_response *r, double now);

/* Takes a position (m) in the direction of the force, read now. */
void response_add(device_response *r, double now, double position);

bool response_is_over(const device_response *r, double now);

/* Returns the result. False if the device did not move like a mass in a hand: it is blocked, out of reach, or moved too much. */
bool response_fit(const device_response *r, response_model *model);

#endif
