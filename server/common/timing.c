#define _GNU_SOURCE
#include "common/timing.h"

#include <errno.h>
#include <math.h>
#include <sys/resource.h>
#include <time.h>

int64_t allocator_calls(void) __attribute__((weak)); /* only defined if tests/shared/allocator_calls.h is linked in or preloaded */

/* Octave k >= 1 covers [32, 64) << (k - 1) in 32 steps. Octave 0 holds the values below 32. */
static int bucket_of(int64_t nanoseconds) {
    if (nanoseconds < HISTOGRAM_OCTAVE) return nanoseconds < 0 ? 0 : (int)nanoseconds;
    int octave = 64 - __builtin_clzll((unsigned long long)nanoseconds) - 5; /* 5 = log2 HISTOGRAM_OCTAVE */
    int step = (int)(nanoseconds >> (octave - 1)) - HISTOGRAM_OCTAVE;
    int bucket = octave * HISTOGRAM_OCTAVE + step;
    return bucket < HISTOGRAM_BUCKETS ? bucket : HISTOGRAM_BUCKETS - 1;
}

static int64_t bucket_top(int bucket) {
    int octave = bucket / HISTOGRAM_OCTAVE, step = bucket % HISTOGRAM_OCTAVE;
    if (octave == 0) return step;
    return ((int64_t)(HISTOGRAM_OCTAVE + step + 1) << (octave - 1)) - 1;
}

void histogram_clear(histogram *h) { *h = (histogram){0}; }

void histogram_add(histogram *h, int64_t nanoseconds) {
    h->count++;
    if (nanoseconds > h->max) h->max = nanoseconds;
    h->buckets[bucket_of(nanoseconds)]++;
}

void histogram_merge(histogram *h, const histogram *other) {
    h->count += other->count;
    if (other->max > h->max) h->max = other->max;
    for (int i = 0; i < HISTOGRAM_BUCKETS; i++) h->buckets[i] += other->buckets[i];
}

double histogram_quantile(const histogram *h, double q) {
    if (h->count == 0) return 0.0;
    double wanted = q * (double)h->count;
    int64_t seen = 0;
    for (int i = 0; i < HISTOGRAM_BUCKETS - 1; i++) {
        seen += h->buckets[i];
        if (seen > 0 && (double)seen >= wanted) return 1e-9 * (double)(bucket_top(i) < h->max ? bucket_top(i) : h->max);
    }
    return histogram_max(h);
}

double histogram_max(const histogram *h) { return 1e-9 * (double)h->max; }

/* A bucket is counted in the bin that contains its upper edge, so bin boundaries are accurate to one bucket width. */
void histogram_bins(const histogram *h, int32_t bins[HISTOGRAM_BINS]) {
    for (int k = 0; k < HISTOGRAM_BINS; k++) bins[k] = 0;
    for (int i = 0; i < HISTOGRAM_BUCKETS; i++) {
        if (h->buckets[i] == 0) continue;
        int k = (int)floor(2.0 * log2(fmax(1e-3 * (double)bucket_top(i), 1e-3)) + 1.0);
        bins[k < 0 ? 0 : k < HISTOGRAM_BINS ? k : HISTOGRAM_BINS - 1] += (int32_t)h->buckets[i];
    }
}

static int64_t nanoseconds_of(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int64_t monotonic_ns(void) { return nanoseconds_of(CLOCK_MONOTONIC); }
int64_t processor_ns(void) { return nanoseconds_of(CLOCK_THREAD_CPUTIME_ID); }
int64_t wall_us(void) { return nanoseconds_of(CLOCK_REALTIME) / 1000; }

void sleep_until(int64_t monotonic) {
    struct timespec t = {.tv_sec = monotonic / 1000000000, .tv_nsec = monotonic % 1000000000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR) continue;
}

bool allocations_are_counted(void) { return allocator_calls; }

thread_usage thread_usage_now(void) {
    struct rusage u;
    getrusage(RUSAGE_THREAD, &u);
    return (thread_usage){.minor_faults = u.ru_minflt, .major_faults = u.ru_majflt, .context_switches = u.ru_nivcsw,
                          .allocations = allocator_calls ? allocator_calls() : 0};
}

thread_usage thread_usage_since(const thread_usage *start) {
    thread_usage now = thread_usage_now();
    return (thread_usage){.minor_faults = now.minor_faults - start->minor_faults,
                          .major_faults = now.major_faults - start->major_faults,
                          .context_switches = now.context_switches - start->context_switches,
                          .allocations = now.allocations - start->allocations};
}
