/* The worker's lateness during an insertion: ticks run in model time, the worker in the processor time of each answer, so that a
   busy machine gives the same figures. One thread.

   It uses internals: it runs the worker at once and withholds each answer until it would have been ready, whereas trocar_sim_work hands an
   answer to the next tick; and it changes the spacing of contact nodes of a model that has been created. */
#ifndef TROCAR_SCALE_TIMING_H
#define TROCAR_SCALE_TIMING_H

#include <stdbool.h>

#include "base/report.h"
#include "common/timing.h"
#include "shared/motion.h"
#include "trocar.h"

typedef struct {
    pose start;              /* of the needle's base, tip before the skin */
    const motion *script;    /* motion after half a second of rest; NULL: along the needle's axis, */
    double speed, depth;     /* m/s, m: at this speed to this depth */
    double dt;               /* s, length of a tick */
    bool free_patches;       /* what the mesh resolves is there as soon as the rows are, as if measuring it took no time */
} scale_case;

typedef struct {
    int ticks, most_contacts;
    histogram tick;          /* of insertion_tick, processor time */
    histogram serve;         /* of each answer, processor time: of its rows, */
    histogram patch;         /* and of measuring what the mesh resolves on one line */
    int contacts;            /* requested contact nodes, each when the tip enters its element: */
    histogram crossing;      /* from there to the tick that could use it */
    histogram activation;    /* of the active ones: delay after the tip left their element (0: before) */
    int unanswered;          /* removed before their row arrived, or without it at the end */
    int crossings;           /* of faces between elements during insertion */
    int late_crossings;      /* whose contact node was not active when the tip had crossed the element (at the hand's speed) */
    int late_ticks;          /* whose snapshot did not cover the tip */
} scale_timing;

trocar_status scale_timing_measure(trocar_sim *sim, const scale_case *wanted, scale_timing *result, report *why);

/* Overrides the scene's smallest distance between contact nodes, m. */
void scale_timing_set_spacing(trocar_model *model, double spacing);

#endif
