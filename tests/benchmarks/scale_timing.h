/* Measures how late the worker is during an insertion. Ticks run in model time, in which the worker takes the CPU time that each answer needs, so that a
   busy machine gives the same figures. Everything runs in one thread. The benchmark uses internals because it runs the worker at once and withholds each
   answer until it would have been ready, whereas trocar_sim_work hands an answer to the next tick. It also changes the spacing of contact nodes in a model
   that already exists. */
#ifndef TROCAR_SCALE_TIMING_H
#define TROCAR_SCALE_TIMING_H

#include <stdbool.h>

#include "base/error.h"
#include "common/timing.h"
#include "shared/motion.h"
#include "trocar.h"

typedef struct {
    pose start;              /* of the needle's base, with the tip in front of the skin */
    const motion *script;    /* motion after half a second of rest, or NULL for a motion along the needle's axis */
    double speed, depth;     /* speed (m/s) and depth (m) of the motion along the axis */
    double dt;               /* s, length of a tick */
    bool free_patches;       /* if set, measuring the mesh's resolution takes no time, and its result comes together with the rows */
} scale_case;

typedef struct {
    int ticks, most_contacts;
    histogram tick;          /* processor time of insertion_tick */
    histogram serve;         /* CPU time of each answer's rows */
    histogram patch;         /* CPU time of measuring the mesh's resolution along one line */
    int contacts;            /* contact nodes requested, each when the tip enters its element */
    histogram crossing;      /* time from that request to the first tick that could use the node */
    histogram activation;    /* for active nodes: delay after the tip left their element, or 0 if they were active before */
    int unanswered;          /* nodes removed before their row arrived, or still without a row at the end */
    int crossings;           /* faces between elements crossed during insertion */
    int late_crossings;      /* those whose contact node was not active when the tip had crossed the element (at the hand's speed) */
    int late_ticks;          /* ticks whose snapshot did not cover the tip */
} scale_timing;

trocar_status scale_timing_measure(trocar_sim *sim, const scale_case *wanted, scale_timing *result, trocar_error *why);

/* m, overrides the scene's smallest distance between contact nodes */
void scale_timing_set_spacing(trocar_model *model, double spacing);

#endif
