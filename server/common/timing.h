/* Clocks and histograms: how late a thread woke and how long it worked. */
#ifndef TROCAR_TIMING_H
#define TROCAR_TIMING_H

#include <stdint.h>

/* Log-linear buckets over nanoseconds: exact below 64 ns, then 32 to an octave (within 3.2 %), up to 68 s. */
enum { HISTOGRAM_OCTAVE = 32, HISTOGRAM_BUCKETS = 32 * HISTOGRAM_OCTAVE };

typedef struct {
    int64_t count;
    int64_t max;                          /* ns, exact */
    uint32_t buckets[HISTOGRAM_BUCKETS];  /* the last one also counts everything longer */
} histogram;

void histogram_clear(histogram *h);
void histogram_add(histogram *h, int64_t nanoseconds); /* negative counts as 0. RT */
void histogram_merge(histogram *h, const histogram *other);    /* adds all values of the other */

/* Upper edge of the bucket that contains the quantile q (0..1), never above the maximum, s; 0 if empty. */
double histogram_quantile(const histogram *h, double q);
double histogram_max(const histogram *h); /* s */

/* For display: bin k counts the values below 2^(k/2) us that are in no earlier bin; the last bin also counts all larger ones. */
enum { HISTOGRAM_BINS = 32 };
void histogram_bins(const histogram *h, int32_t bins[HISTOGRAM_BINS]);

int64_t monotonic_ns(void);               /* CLOCK_MONOTONIC, for control. RT */
int64_t processor_ns(void);               /* of the calling thread, for work that the scheduler may interrupt. RT */
int64_t wall_us(void);                    /* CLOCK_REALTIME, for the utime of messages, never for control. RT */
void sleep_until(int64_t monotonic);      /* absolute, ns; resumes after signals. RT */

/* Counters of one thread. */
typedef struct {
    int64_t minor_faults, major_faults, context_switches; /* involuntary */
    int64_t allocations;                                  /* calls of the allocator */
} thread_usage;

thread_usage thread_usage_now(void);      /* of the calling thread; a cheap system call. RT */
thread_usage thread_usage_since(const thread_usage *start); /* of the calling thread, since `start`. RT */

#endif
