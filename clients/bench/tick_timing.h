/* Measures the time per tick with a given number of contacts while the needle moves as in normal use. The simulation and its worker run in lockstep,
   in one thread. */
#ifndef TROCAR_TICK_TIMING_H
#define TROCAR_TICK_TIMING_H

#include "base/error.h"
#include "base/vec.h"
#include "common/timing.h"
#include "trocar.h"

typedef enum {
    TIMED_ADVANCE,           /* moves along the needle's axis at 20 mm/s */
    TIMED_SWEEP,             /* moves sideways back and forth at 30 mm/s, by 7.5 mm to each side, once per second */
    TIMED_MOTIONS
} timed_motion;

const char *timed_motion_name(timed_motion motion);

/* Settings of the measurement. */
typedef struct {
    pose start;              /* pose of the needle's base with the tip in front of the skin; the insertion follows the needle's axis */
    double dt;               /* s, duration of a tick */
    int contacts;            /* the needle is inserted until it has this many contacts; ticks are timed as long as this number does not change */
    int ticks;               /* number of ticks to time; the insertion is repeated until enough ticks have been timed */
    timed_motion motion;
    double turn_rate;        /* rad/s, rate at which the base turns about the needle's axis during the motion */
} timing_case;

typedef struct {
    histogram time;          /* time of trocar_sim_tick alone, excluding the worker's part */
    int contacts;            /* number of contacts during the timed ticks */
    double passes, switches; /* mean per tick */
    double stages[TROCAR_STAGES]; /* s, mean duration of each stage per tick, including the overhead of reading the clock */
    int unstable;            /* number of ticks without an equilibrium */
} tick_timing;

/* Resets the needle of `sim`, which is a simulation of `scene`, to the start pose, inserts it and times the ticks. BAD_INPUT if the needle gets fewer
   contacts than requested; the message gives the number. */
trocar_status tick_timing_measure(trocar_sim *sim, const trocar_scene *scene, const timing_case *wanted, tick_timing *result, trocar_error *why);

/* Adds the ticks of `part` to `sum`. */
void tick_timing_add(tick_timing *sum, const tick_timing *part);

#endif
