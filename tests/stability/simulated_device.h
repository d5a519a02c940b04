/* A haptic device in a person's hand, behind a delay: a mass with viscous damping, which the hand's spring pulls to where the hand wants
   it. It stands for the device in tests, inside of a process or behind a program. No threads, no clock: time is an argument. */
#ifndef TROCAR_TESTS_SIMULATED_DEVICE_H
#define TROCAR_TESTS_SIMULATED_DEVICE_H

#include <stddef.h>

#include "device/hand.h"

enum { DEVICE_FORCES = 256 };  /* forces on their way to the device */

typedef struct {
    double mass;             /* kg, > 0, of device and hand together, at the handle */
    double damping;          /* N s/m, >= 0, to ground, of device and hand together */
    double stiffness;        /* N/m, > 0, of the hand */
    double delay;            /* s, >= 0, each way: until a force acts, and until a position is read */
    double period;           /* s, of the device's own loop, which applies forces and samples positions; 0: at any time */
    double resolution;       /* m, of the positions that are read; 0: exact */
} device_properties;

typedef struct {
    device_properties properties;
    hand hand;
    double time;             /* s, to which `hand` has been computed */
    vec3 target;             /* m, where the hand wants it at the beginning of the push */
    vec3 velocity;           /* m/s, of the target while the hand pushes */
    double begin, end;       /* s, of the push */
    vec3 amplitude;          /* m, to and fro around it */
    double frequency;        /* Hz */
    double shaken_from, shaken_until; /* s */
    vec3 force;              /* N, that acts now */
    struct { double due; vec3 force; } forces[DEVICE_FORCES]; /* on their way, by number modulo DEVICE_FORCES */
    long applied, sent;      /* numbers of the next one that acts, and of the next one to be sent */
    vec3 lowest, highest;    /* m, of the position since device_watch */
} simulated_device;

/* At rest at `position` from time `now` on. */
void device_init(simulated_device *d, const device_properties *properties, vec3 position, double now);

/* The hand's target moves at this velocity from `begin` until `end` (s), from where it is. */
void device_push(simulated_device *d, vec3 velocity, double begin, double end);

/* The hand's target also goes to and fro by `amplitude` (m) around where it is, `frequency` times a second, from `begin` until `end` (s). */
void device_shake(simulated_device *d, vec3 amplitude, double frequency, double begin, double end);

/* The newest force (N), given at time `now` (s); times may not decrease. It acts after the delay, until the next one does. */
void device_apply(simulated_device *d, double now, vec3 force);

/* Position (m) as a program reads it at time `now` (s): it was there before the delay. */
vec3 device_read(simulated_device *d, double now);

/* Forgets the lowest and highest positions. */
void device_watch(simulated_device *d);

/* Distance (m) between the lowest and the highest position since then. */
double device_swing(const simulated_device *d);

/* Bytes of a simulated_device, for other languages. */
size_t device_size(void);

#endif
