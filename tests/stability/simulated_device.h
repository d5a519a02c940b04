/* A haptic device with a delay, held by a person's hand: a mass with viscous damping, pulled by the hand's spring toward the hand's target. Stands in for
   the device in tests, in the same process or connected to another program. Uses neither threads nor a clock: time is passed in as an argument. */
#ifndef TROCAR_TESTS_SIMULATED_DEVICE_H
#define TROCAR_TESTS_SIMULATED_DEVICE_H

#include <stddef.h>

#include "device/hand.h"

enum { DEVICE_FORCES = 256 };  /* most forces in transit to the device */

typedef struct {
    double mass;             /* kg, > 0, effective mass of device and hand together at the handle */
    double damping;          /* N s/m, >= 0, of device and hand together relative to ground */
    double stiffness;        /* N/m, > 0, of the hand */
    double delay;            /* s, >= 0, each way: until a force acts, and until a position can be read */
    double period;           /* s, of the device's own loop, which applies forces and samples positions; 0 if it does so at any time */
    double resolution;       /* m, of the position that a program reads */
} device_properties;

typedef struct {
    device_properties properties;
    hand hand;
    double time;             /* s, time up to which `hand` has been computed */
    vec3 target;             /* m, the hand's target when the push begins */
    vec3 velocity;           /* m/s, of the target while the hand pushes */
    double begin, end;       /* s, of the push */
    vec3 amplitude;          /* m, of an oscillation around the target */
    double frequency;        /* Hz */
    double shaken_from, shaken_until; /* s */
    vec3 force;              /* N, acting at present */
    struct { double due; vec3 force; } forces[DEVICE_FORCES]; /* in transit, indexed by their number modulo DEVICE_FORCES */
    long applied, sent;      /* applied: number of the next force to act; sent: number of the next to be sent */
    vec3 lowest, highest;    /* m, extremes of the position since device_watch */
} simulated_device;

/* Starts at rest at `position` from time `now` on. */
void device_init(simulated_device *d, const device_properties *properties, vec3 position, double now);

/* Moves the hand's target at this velocity, starting from where it is, from `begin` until `end` (s). */
void device_push(simulated_device *d, vec3 velocity, double begin, double end);

/* Also makes the hand's target oscillate by `amplitude` (m) around its position, `frequency` times per second, from `begin` until `end` (s). */
void device_shake(simulated_device *d, vec3 amplitude, double frequency, double begin, double end);

/* Applies the newest force (N), given at time `now` (s), which may not decrease. It acts after the delay, until the next force does. */
void device_apply(simulated_device *d, double now, vec3 force);

/* Returns the position (m) that a program reads at time `now` (s): where the device was one delay earlier. */
vec3 device_read(simulated_device *d, double now);

/* Resets the lowest and highest positions. */
void device_watch(simulated_device *d);

/* Returns the distance (m) between the lowest and the highest position since device_watch. */
double device_swing(const simulated_device *d);

/* Returns the size of a simulated_device in bytes, for bindings in other languages. */
size_t device_size(void);

#endif
