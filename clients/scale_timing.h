/* How late the worker answers while a needle goes in: the tick's clock is the model's, the worker's is the processor time that
   each answer took, so that a loaded machine gives the same figures. One thread.

   This benchmark, like that of remeshing, is one of internals: it follows single contact nodes, and hands over an answer only when
   it would have been ready, for which a host of the library has no use. Its measuring (scale_timing.c) is built with core's headers. */
#ifndef TROCAR_SCALE_TIMING_H
#define TROCAR_SCALE_TIMING_H

#include "base/report.h"
#include "motion.h"
#include "timing.h"
#include "trocar.h"

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

trocar_status scale_timing_measure(trocar_sim *sim, const scale_case *wanted, scale_timing *result, report *why);

/* Least distance between contact nodes from now on, m, in place of the scene's. */
void scale_timing_set_spacing(trocar_model *model, double spacing);

int64_t processor_ns(void);  /* of this thread */

#endif
