/* Timing of the haptic loop: absolute deadlines, missed periods and histograms. The caller supplies the tick. */
#ifndef TROCAR_LOOP_H
#define TROCAR_LOOP_H

#include "base/triple_buffer.h"
#include "common/timing.h"
#include "phase_lock.h"

/* Timing information that the loop passes to each tick. */
typedef struct {
    int64_t tick;            /* number of the tick, counted from 0 */
    int64_t now;             /* ns, monotonic: time at which the thread woke up */
    double elapsed;          /* s of model time since the last tick: one period, or more if periods were missed */
    bool late;               /* true if periods were missed before this tick */
} loop_wake;

enum { LOOP_STAGES = 6 };    /* number of stages of a tick, as in loop_timing_t */

/* Timing for telemetry, published ten times per second. */
typedef struct {
    histogram lateness, compute;                     /* histograms of the ticks in the last tenth of a second */
    int64_t stage_total[LOOP_STAGES], stage_max[LOOP_STAGES]; /* ns, sum and maximum of each stage in the same tenth of a second */
    double lateness_max_total, compute_max_total;    /* s, largest values since the loop started */
    int64_t ticks, misses;                           /* since start */
    thread_usage usage;                              /* resource usage since the loop started, sampled once per second */
} loop_record;

typedef struct {
    double rate_hz;
    bool (*tick)(void *context, const loop_wake *wake); /* a return value of false ends the loop. RT */
    void *context;
    const int64_t *stages;   /* ns, duration of each of the LOOP_STAGES stages of the last tick, written by the tick; may be NULL */
    const int64_t *received; /* ns, monotonic: arrival time of the pose to which the last tick responded, 0 if there was none; if the pointer is NULL,
                                there is no phase lock */
    triple_buffer *records;   /* loop_record */
    histogram lateness, compute;                     /* histograms of all ticks; valid after the loop has ended */
    int64_t ticks, misses;
    thread_usage usage;
} loop;

/* Calls `tick` at the loop's rate, in the calling thread, until it returns false. If `received` is set, the phase follows the arrival of the poses
   (phase_lock.h). Periods lost to a late tick are skipped and counted, never replayed in a burst. The loop itself makes no allocation, takes no lock,
   opens no file and causes no page fault. RT */
void loop_run(loop *l);

#endif
