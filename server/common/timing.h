/* Clocks and histograms, for the lateness and the compute time of threads. */
#ifndef TROCAR_TIMING_H
#define TROCAR_TIMING_H

#include <stdint.h>

/* Buckets over nanoseconds: exact below 64 ns, then 32 per octave (within 3.2 %), up to 68 s. */
enum { HISTOGRAM_OCTAVE = 32, HISTOGRAM_BUCKETS = 32 * HISTOGRAM_OCTAVE };

typedef struct {
    int64_t count;
    int64_t max;                          /* ns, exact */
    uint32_t buckets[HISTOGRAM_BUCKETS];  /* the last one also counts everything longer */
} histogram;

void histogram_clear(histogram *h);
void histogram_add(histogram *h, int64_t nanoseconds); /* a negative value counts as 0. RT */
void histogram_merge(histogram *h, const histogram *other);    /* adds all values of `other` */

/* Returns the upper edge (s) of the bucket that contains the quantile q (0..1), never above the maximum; 0 if the histogram is empty. */
double histogram_quantile(const histogram *h, double q);
double histogram_max(const histogram *h); /* s */

/* For display: bin k counts the values below 2^(k/2) us that no earlier bin counts; the last bin also counts all larger values. */
enum { HISTOGRAM_BINS = 32 };
void histogram_bins(const histogram *h, int32_t bins[HISTOGRAM_BINS]);

int64_t monotonic_ns(void);               /* CLOCK_MONOTONIC, for control. RT */
int64_t processor_ns(void);               /* processor time of the calling thread, for work that the scheduler may interrupt. RT */
int64_t wall_us(void);                    /* CLOCK_REALTIME, for the utime of messages, never for control. RT */
void sleep_until(int64_t monotonic);      /* sleeps until this absolute time, ns; resumes after signals. RT */

/* Counters of one thread. */
typedef struct {
    int64_t minor_faults, major_faults, context_switches; /* involuntary */
    int64_t allocations;                                  /* calls of the allocator */
} thread_usage;

thread_usage thread_usage_now(void);      /* of the calling thread, by one cheap system call. RT */
thread_usage thread_usage_since(const thread_usage *start); /* of the calling thread, since `start`. RT */

#endif
