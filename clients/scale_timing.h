/* How late the worker answers while a needle goes in: the tick's clock is the model's, the worker's is the processor time that
   each answer took, so that a loaded machine gives the same figures. One thread. */
#ifndef TROCAR_SCALE_TIMING_H
#define TROCAR_SCALE_TIMING_H

#include "motion.h"
#include "insertion/simulation.h"
#include "timing.h"

typedef struct {
    pose start;              /* of the needle's base, tip before the skin */
    const motion *script;    /* what it does from there, after half a second of rest; or NULL: it goes in along its axis, */
    double speed, depth;     /* m/s, m: so fast, so far */
    double dt;               /* s, length of a tick */
} scale_case;

typedef struct {
    int ticks, most_contacts;
    histogram tick;          /* of insertion_tick, processor time */
    histogram serve;         /* of each answer, processor time */
    int contacts;            /* contact nodes asked for, each as the tip crosses the face into its element: */
    histogram crossing;      /* from there to the tick that could take it, if the tip had come so far */
    histogram activation;    /* of those that took part: how long after the tip had left their element (0: before) */
    int unanswered;          /* gone again before their row was there, or still without at the end */
    int crossings;           /* of faces between elements, on the way in */
    int late_crossings;      /* whose contact node was not active yet when the tip had crossed the element (at the hand's speed) */
    int late_ticks;          /* whose snapshot did not cover the tip */
} scale_timing;

trocar_status scale_timing_measure(simulation *s, const scale_case *wanted, scale_timing *result, report *why);

int64_t processor_ns(void);  /* of this thread */

#endif
