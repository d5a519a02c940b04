/* Measures the time of one tick with a given number of contacts while the needle moves as in use. In lockstep, in one thread. */
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

/* What is measured, and how. */
typedef struct {
    pose start;              /* pose of the needle's base with the tip in front of the skin; the needle moves along its axis */
    double dt;               /* s, length of a tick */
    int contacts;            /* the needle is inserted until it has this many contacts; ticks are timed as long as the number stays the same */
    int ticks;               /* number of ticks to time; the insertion is repeated until that many have been timed */
    timed_motion motion;
    double turn_rate;        /* rad/s, rotation of the base about the needle's axis during the motion */
} timing_case;

typedef struct {
    histogram time;          /* time of trocar_sim_tick alone, without the worker's part */
    int contacts;            /* number of contacts in the timed ticks */
    double passes, switches; /* mean per tick */
    double stages[TROCAR_STAGES]; /* s, mean per tick, including the clock's own time */
    int unstable;            /* number of ticks without an equilibrium */
} tick_timing;

/* Resets the needle of `sim`, a simulation of `scene`, to the start, pushes it in and times the ticks. BAD_INPUT if the needle meets fewer contacts
   than requested; the message says how many. */
trocar_status tick_timing_measure(trocar_sim *sim, const trocar_scene *scene, const timing_case *wanted, tick_timing *result, report *why);

/* Adds the ticks of `part` to `sum`. */
void tick_timing_add(tick_timing *sum, const tick_timing *part);

#endif
