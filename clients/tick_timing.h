/* How long one tick takes with a given number of contacts, while the needle moves as in use. Lockstep, one thread. */
#ifndef TROCAR_TICK_TIMING_H
#define TROCAR_TICK_TIMING_H

#include "insertion/simulation.h"
#include "timing.h"

typedef enum {
    TIMED_ADVANCE,           /* on along the needle's axis at 20 mm/s */
    TIMED_SWEEP,             /* sideways to and fro at 30 mm/s, 7.5 mm to each side, once a second */
    TIMED_MOTIONS
} timed_motion;

const char *timed_motion_name(timed_motion motion);

/* What to measure. */
typedef struct {
    pose start;              /* of the needle's base, tip before the skin; the needle goes in along its axis */
    double dt;               /* s, length of a tick */
    int contacts;            /* the needle goes in until it has these; then the clock runs, as long as there are as many, */
    int ticks;               /* again and again until so many ticks have been timed */
    timed_motion motion;
} timing_case;

typedef struct {
    histogram time;          /* of insertion_tick alone, without what the worker would do */
    int contacts;            /* there while timed */
    double passes, switches; /* a tick, mean */
    int unstable;            /* ticks without an equilibrium */
} tick_timing;

/* Resets the needle to the start, pushes it in and times it. BAD_INPUT when there are fewer contacts along its way than
   asked for, with how many there are. */
trocar_status tick_timing_measure(simulation *s, const timing_case *wanted, tick_timing *result, report *why);

#endif
