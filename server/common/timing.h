/* Clocks, and histograms of how late threads wake up and how long they compute. */
#ifndef TROCAR_TIMING_H
#define TROCAR_TIMING_H

#include <stdbool.h>
#include <stdint.h>

/* A histogram in nanoseconds: exact below 64 ns, then 32 buckets per octave (within 3.2 %), up to 68 s. */
enum { HISTOGRAM_OCTAVE = 32, HISTOGRAM_BUCKETS = 32 * HISTOGRAM_OCTAVE };

typedef struct {
    int64_t count;
    int64_t max;                          /* ns, exact */
    uint32_t buckets[HISTOGRAM_BUCKETS];  /* the last bucket also counts anything longer */
} histogram;

void histogram_clear(histogram *h);
void histogram_add(histogram *h, int64_t nanoseconds); /* counts a negative value as 0. RT */
void histogram_merge(histogram *h, const histogram *other);    /* adds the counts of `other` to `h` */

/* Returns the upper edge (s) of the bucket that contains quantile q (0 to 1), but no more than the maximum; 0 if the histogram is empty. */
double histogram_quantile(const histogram *h, double q);
double histogram_max(const histogram *h); /* s */

/* For display. Bin k counts the values below 2^(k/2) us that are not in an earlier bin; the last bin also counts all larger values. */
enum { HISTOGRAM_BINS = 32 };
void histogram_bins(const histogram *h, int32_t bins[HISTOGRAM_BINS]);

int64_t monotonic_ns(void);               /* CLOCK_MONOTONIC, for control. RT */
int64_t processor_ns(void);               /* CPU time of the calling thread, for timing work that may be preempted. RT */
int64_t wall_us(void);                    /* CLOCK_REALTIME, for the utime of messages but never for control. RT */
void sleep_until(int64_t monotonic);      /* until this absolute time (ns), even if signals arrive. RT */

/* What one thread has used. */
typedef struct {
    int64_t minor_faults, major_faults, context_switches; /* page faults, and involuntary context switches */
    int64_t allocations;                                  /* allocator calls; 0 if not counted */
} thread_usage;

bool allocations_are_counted(void);       /* true only with the counter of the tests, tests/shared/allocator_calls.h */

thread_usage thread_usage_now(void);      /* of the calling thread so far. Costs one cheap system call. RT */
thread_usage thread_usage_since(const thread_usage *start); /* of the calling thread since `start`. RT */

#endif
