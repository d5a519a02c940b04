/* Clocks, and histograms of the lateness and compute time of threads. */
#ifndef TROCAR_TIMING_H
#define TROCAR_TIMING_H

#include <stdbool.h>
#include <stdint.h>

/* Histogram buckets in nanoseconds: exact below 64 ns, then 32 per octave (within 3.2 %), up to 68 s. */
enum { HISTOGRAM_OCTAVE = 32, HISTOGRAM_BUCKETS = 32 * HISTOGRAM_OCTAVE };

typedef struct {
    int64_t count;
    int64_t max;                          /* ns, exact */
    uint32_t buckets[HISTOGRAM_BUCKETS];  /* the last bucket also counts all longer times */
} histogram;

void histogram_clear(histogram *h);
void histogram_add(histogram *h, int64_t nanoseconds); /* a negative value counts as 0. RT */
void histogram_merge(histogram *h, const histogram *other);    /* adds all values of `other` to `h` */

/* Returns the upper edge (s) of the bucket that contains the quantile q (0..1), but never more than the maximum; 0 if the histogram is empty. */
double histogram_quantile(const histogram *h, double q);
double histogram_max(const histogram *h); /* s */

/* For display: bin k counts the values below 2^(k/2) us that are not in an earlier bin; the last bin also counts all larger values. */
enum { HISTOGRAM_BINS = 32 };
void histogram_bins(const histogram *h, int32_t bins[HISTOGRAM_BINS]);

int64_t monotonic_ns(void);               /* time of CLOCK_MONOTONIC, used for control. RT */
int64_t processor_ns(void);               /* processor time of the calling thread, for timing work that the scheduler may interrupt. RT */
int64_t wall_us(void);                    /* time of CLOCK_REALTIME, used for the utime of messages, never for control. RT */
void sleep_until(int64_t monotonic);      /* sleeps until this absolute time (ns), even if signals arrive. RT */

/* Resource usage counters of one thread. */
typedef struct {
    int64_t minor_faults, major_faults, context_switches; /* page faults, and involuntary context switches */
    int64_t allocations;                                  /* number of calls to the allocator; 0 if they are not counted */
} thread_usage;

bool allocations_are_counted(void);       /* true only with the tests' counter, tests/shared/allocator_calls.h */

thread_usage thread_usage_now(void);      /* usage of the calling thread, read with one cheap system call. RT */
thread_usage thread_usage_since(const thread_usage *start); /* usage of the calling thread since `start`. RT */

#endif
