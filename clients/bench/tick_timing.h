/* Time of one tick with a given number of contacts while the needle moves as in use. Lockstep, one thread. */
#ifndef TROCAR_TICK_TIMING_H
#define TROCAR_TICK_TIMING_H

#include "base/report.h"
#include "base/vec.h"
#include "common/timing.h"
#include "trocar.h"

typedef enum {
    TIMED_ADVANCE,           /* along the needle's axis at 20 mm/s */
    TIMED_SWEEP,             /* sideways back and forth at 30 mm/s, 7.5 mm to each side, once a second */
    TIMED_MOTIONS
} timed_motion;

const char *timed_motion_name(timed_motion motion);

/* What to measure. */
typedef struct {
    pose start;              /* of the needle's base, tip before the skin; the needle moves along its axis */
    double dt;               /* s, length of a tick */
    int contacts;            /* the needle is inserted until it has this many; ticks are timed while it has them, */
    int ticks;               /* number of ticks to time: the insertion is repeated until they have been timed */
    timed_motion motion;
    double turn_rate;        /* rad/s, rotation of the base about the needle's axis meanwhile */
} timing_case;

typedef struct {
    histogram time;          /* of trocar_sim_tick alone, without the worker's part */
    int contacts;            /* present while timed */
    double passes, switches; /* mean per tick */
    double stages[TROCAR_STAGES]; /* s, mean per tick, including the clock's own time */
    int unstable;            /* ticks without an equilibrium */
} tick_timing;

/* Resets the needle of `sim`, a simulation of `scene`, to the start, pushes it in and times it. BAD_INPUT if it meets fewer contacts than requested;
   the message says how many. */
trocar_status tick_timing_measure(trocar_sim *sim, const trocar_scene *scene, const timing_case *wanted, tick_timing *result, report *why);

/* Adds the ticks of `part`. */
void tick_timing_add(tick_timing *sum, const tick_timing *part);

#endif
