/* The shell of the haptic loop: absolute deadlines, missed periods, timings. What a tick does is its caller's affair. */
#ifndef TROCAR_LOOP_H
#define TROCAR_LOOP_H

#include "base/triple_buffer.h"
#include "timing.h"

/* What a tick is told about its time. */
typedef struct {
    int64_t tick;            /* from 0 */
    int64_t now;             /* ns, monotonic, when the thread woke */
    double elapsed;          /* s of model time since the last tick: one period, or more after missed ones */
    bool late;               /* periods were missed before this tick */
} loop_wake;

enum { LOOP_STAGES = 6 };    /* of a tick, as in loop_timing_t */

/* Timing as telemetry gets it ten times a second. */
typedef struct {
    histogram lateness, compute;                     /* of the last tenth of a second */
    int64_t stage_total[LOOP_STAGES], stage_max[LOOP_STAGES]; /* ns, of the same time */
    double lateness_max_total, compute_max_total;    /* s, since start */
    int64_t ticks, misses;                           /* since start */
    thread_usage usage;                              /* since the loop began, sampled once a second */
} loop_record;

typedef struct {
    double rate_hz;
    bool (*tick)(void *context, const loop_wake *wake); /* false ends the loop. RT */
    void *context;
    const int64_t *stages;   /* LOOP_STAGES, ns: how the last tick spent its time, kept by the tick; may be NULL */
    triple_buffer *records;   /* loop_record */
    histogram lateness, compute;                     /* totals; to be read when the loop has ended */
    int64_t ticks, misses;
    thread_usage usage;
} loop;

/* Runs ticks at the rate, in the calling thread, until one returns false. Periods that a late tick has eaten are
   skipped and counted, never replayed in a burst. No allocation, lock, file or page fault. RT */
void loop_run(loop *l);

#endif
