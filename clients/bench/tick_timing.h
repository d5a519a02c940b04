/* Measures the time per tick for a given number of contacts while the needle moves as it does in normal use. The simulation and its worker run in lockstep, in
   a single thread. */
#ifndef TROCAR_TICK_TIMING_H
#define TROCAR_TICK_TIMING_H

#include "base/error.h"
#include "base/vec.h"
#include "common/timing.h"
#include "trocar.h"

typedef enum {
    TIMED_ADVANCE,           /* moves along its axis at 20 mm/s */
    TIMED_SWEEP,             /* moves sideways at 30 mm/s, 7.5 mm to each side, one cycle per second */
    TIMED_MOTIONS
} timed_motion;

const char *timed_motion_name(timed_motion motion);

/* What to measure. */
typedef struct {
    pose start;              /* pose of the needle's base with the tip in front of the skin; the needle is inserted along its axis */
    double dt;               /* s, duration of a tick */
    int contacts;            /* insert the needle until it has this many contacts; time ticks only while it keeps that number */
    int ticks;               /* ticks to time; the insertion is repeated until there are enough */
    timed_motion motion;
    double turn_rate;        /* rad/s, how fast the base turns about the needle's axis during the motion */
} timing_case;

typedef struct {
    histogram time;          /* of trocar_sim_tick alone, without the worker's part */
    int contacts;            /* during the timed ticks */
    double passes, switches; /* mean per tick */
    double stages[TROCAR_STAGES]; /* s, mean time of each stage per tick, including the overhead of reading the clock */
    int unstable;            /* number of ticks in which no equilibrium was found */
} tick_timing;

/* Resets the needle of `sim`, a simulation of `scene`, to the start pose, inserts it and times the ticks. Returns BAD_INPUT if the needle gets fewer contacts
   than requested; the message says how many it gets. */
trocar_status tick_timing_measure(trocar_sim *sim, const trocar_scene *scene, const timing_case *wanted, tick_timing *result, trocar_error *why);

/* Merges the measurement `part` into `sum`. */
void tick_timing_add(tick_timing *sum, const tick_timing *part);

#endif
