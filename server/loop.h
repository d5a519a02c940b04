/* The haptic loop's timing: absolute deadlines, missed periods, histograms. The caller supplies the tick. */
#ifndef TROCAR_LOOP_H
#define TROCAR_LOOP_H

#include "base/triple_buffer.h"
#include "common/timing.h"
#include "phase_lock.h"

/* Timing information for a tick. */
typedef struct {
    int64_t tick;            /* from 0 */
    int64_t now;             /* ns, monotonic, when the thread woke */
    double elapsed;          /* s of model time since the last tick: one period, or more after missed ones */
    bool late;               /* periods were missed before this tick */
} loop_wake;

enum { LOOP_STAGES = 6 };    /* of a tick, as in loop_timing_t */

/* Timing for telemetry, ten times per second. */
typedef struct {
    histogram lateness, compute;                     /* of the last tenth of a second */
    int64_t stage_total[LOOP_STAGES], stage_max[LOOP_STAGES]; /* ns, in the same interval */
    double lateness_max_total, compute_max_total;    /* s, since start */
    int64_t ticks, misses;                           /* since start */
    thread_usage usage;                              /* since the loop started, sampled once per second */
} loop_record;

typedef struct {
    double rate_hz;
    bool (*tick)(void *context, const loop_wake *wake); /* false ends the loop. RT */
    void *context;
    const int64_t *stages;   /* LOOP_STAGES, ns: the last tick's time by stage, written by the tick; may be NULL */
    const int64_t *received; /* ns, monotonic: arrival of the pose that the last tick answered, 0: none; NULL: no phase lock */
    triple_buffer *records;   /* loop_record */
    histogram lateness, compute;                     /* totals, valid after the loop has ended */
    int64_t ticks, misses;
    thread_usage usage;
} loop;

/* Runs ticks at the rate, in the calling thread, until one returns false. With `received`, the phase follows the poses (phase_lock.h). Periods lost to a late tick are
   skipped and counted, never replayed in a burst. No allocation, lock, file or page fault. RT */
void loop_run(loop *l);

#endif
