/* Timing of the haptic loop: absolute deadlines, missed periods, histograms. The tick itself is supplied by the caller. */
#ifndef TROCAR_LOOP_H
#define TROCAR_LOOP_H

#include "base/triple_buffer.h"
#include "common/timing.h"
#include "phase_lock.h"

/* What each tick is told about its timing. */
typedef struct {
    int64_t tick;            /* number of the tick, starting from 0 */
    int64_t now;             /* ns, monotonic: when the thread woke up */
    double elapsed;          /* s of model time since the last tick: one period, or more if periods were missed */
    bool late;               /* periods were missed before this tick */
} loop_wake;

enum { LOOP_STAGES = 6 };    /* stages of a tick, as in loop_timing_t */

/* Timing for telemetry, published ten times per second. */
typedef struct {
    histogram lateness, compute;                     /* of the ticks in the last tenth of a second */
    int64_t stage_total[LOOP_STAGES], stage_max[LOOP_STAGES]; /* ns, sum and maximum of each stage over the same ticks */
    double lateness_max_total, compute_max_total;    /* s, largest values since the loop started */
    int64_t ticks, misses;                           /* since start */
    thread_usage usage;                              /* since the loop started, sampled once per second */
} loop_record;

typedef struct {
    double rate_hz;
    bool (*tick)(void *context, const loop_wake *wake); /* returns false to end the loop. RT */
    void *context;
    const int64_t *stages;   /* ns, LOOP_STAGES durations that each tick writes; may be NULL */
    const int64_t *received; /* ns, monotonic: arrival of the pose that the last tick responded to, 0 if none. If the pointer is NULL, there is no phase lock */
    triple_buffer *records;   /* loop_record */
    histogram lateness, compute;                     /* of all ticks; valid once the loop has ended */
    int64_t ticks, misses;
    thread_usage usage;
} loop;

/* Calls `tick` at the loop's rate, in the calling thread, until it returns false. If `received` is set, the phase follows the arrival of poses (phase_lock.h).
   Periods missed because a tick was late are skipped and counted, never made up for in a burst. The loop itself does not allocate, lock, open files or cause
   page faults. RT */
void loop_run(loop *l);

#endif
