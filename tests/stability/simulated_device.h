/* A haptic device in a person's hand, behind a delay: a mass with viscous damping, which the hand's spring pulls to the hand's target.
   It represents the device in tests, inside a process or behind a program. No threads, no clock: time is an argument. */
#ifndef TROCAR_TESTS_SIMULATED_DEVICE_H
#define TROCAR_TESTS_SIMULATED_DEVICE_H

#include <stddef.h>

#include "device/hand.h"

enum { DEVICE_FORCES = 256 };  /* largest number of forces in transit to the device */

typedef struct {
    double mass;             /* kg, > 0, mass of device and hand together, at the handle */
    double damping;          /* N s/m, >= 0, to ground, of device and hand together */
    double stiffness;        /* N/m, > 0, of the hand */
    double delay;            /* s, >= 0, each way: until a force acts, and until a position is read */
    double period;           /* s, period of the device's own loop, which applies forces and samples positions; 0: at any time */
    double resolution;       /* m, of the position that a program reads */
} device_properties;

typedef struct {
    device_properties properties;
    hand hand;
    double time;             /* s, time up to which `hand` has been computed */
    vec3 target;             /* m, position of the hand's target at the beginning of the push */
    vec3 velocity;           /* m/s, velocity of the target while the hand pushes */
    double begin, end;       /* s, beginning and end of the push */
    vec3 amplitude;          /* m, amplitude of an oscillation around the target */
    double frequency;        /* Hz */
    double shaken_from, shaken_until; /* s */
    vec3 force;              /* N, force that acts at present */
    struct { double due; vec3 force; } forces[DEVICE_FORCES]; /* forces in transit, by number modulo DEVICE_FORCES */
    long applied, sent;      /* numbers of the next force that acts, and of the next force to be sent */
    vec3 lowest, highest;    /* m, range of the position since device_watch */
} simulated_device;

/* Starts at rest at `position` from time `now` on. */
void device_init(simulated_device *d, const device_properties *properties, vec3 position, double now);

/* Moves the hand's target from its position at this velocity from `begin` until `end` (s). */
void device_push(simulated_device *d, vec3 velocity, double begin, double end);

/* Also oscillates the hand's target by `amplitude` (m) around its position, `frequency` times a second, from `begin` until `end` (s). */
void device_shake(simulated_device *d, vec3 amplitude, double frequency, double begin, double end);

/* Applies the newest force (N), given at time `now` (s); times may not decrease. It acts after the delay, until the next one does. */
void device_apply(simulated_device *d, double now, vec3 force);

/* Returns the position (m) that a program reads at time `now` (s): the device was there one delay earlier. */
vec3 device_read(simulated_device *d, double now);

/* Resets the lowest and highest positions. */
void device_watch(simulated_device *d);

/* Returns the distance (m) between the lowest and the highest position since then. */
double device_swing(const simulated_device *d);

/* Returns the size of a simulated_device, for other languages. */
size_t device_size(void);

#endif
