/* Compares histograms with sorted samples, and clocks with each other. */
#define _GNU_SOURCE
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#include "common/timing.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

enum { SAMPLES = 20001 };

static int ascending(const void *a, const void *b) {
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

/* Draws samples spread over six decades, as real latencies are, with a fixed generator (Numerical Recipes' LCG). */
static void draw(int64_t *samples) {
    uint32_t random = 12345;
    for (int i = 0; i < SAMPLES; i++) {
        random = 1664525u * random + 1013904223u;
        int shift = (int)(random >> 27);
        random = 1664525u * random + 1013904223u;
        samples[i] = (int64_t)(random >> 3) >> (shift % 28);
    }
}

static void quantiles_agree_with_sorting(void **unused) {
    (void)unused;
    static int64_t samples[SAMPLES];
    static histogram h;
    draw(samples);
    for (int i = 0; i < SAMPLES; i++) histogram_add(&h, samples[i]);
    qsort(samples, SAMPLES, sizeof *samples, ascending);
    const double quantiles[] = {0.01, 0.1, 0.5, 0.9, 0.99, 0.999};
    for (size_t k = 0; k < sizeof quantiles / sizeof *quantiles; k++) {
        double exact = 1e-9 * (double)samples[(int)(quantiles[k] * SAMPLES)];
        double found = histogram_quantile(&h, quantiles[k]);
        assert_true(found >= exact * (1 - 1e-12));           /* `found` is the bucket's upper edge */
        assert_true(found <= exact * (1 + 1.0 / 32) + 1e-9); /* a bucket is at most 1/32 of an octave wide */
    }
    assert_int_equal(h.count, SAMPLES);
    assert_int_equal(h.max, samples[SAMPLES - 1]);
    assert_true(histogram_quantile(&h, 1.0) == histogram_max(&h));
}

static void extremes_are_kept(void **unused) {
    (void)unused;
    static histogram h;
    assert_true(histogram_quantile(&h, 0.99) == 0.0);
    histogram_add(&h, -5);
    assert_true(histogram_quantile(&h, 0.5) == 0.0);
    histogram_add(&h, INT64_MAX);
    assert_int_equal(h.max, INT64_MAX);
    assert_true(histogram_quantile(&h, 1.0) == 1e-9 * (double)INT64_MAX);
    assert_int_equal(h.count, 2);
}

static void bins_contain_values_between_their_edges(void **unused) {
    (void)unused;
    static int64_t samples[SAMPLES];
    static histogram h;
    int32_t bins[HISTOGRAM_BINS], expected[HISTOGRAM_BINS] = {0};
    draw(samples);
    for (int i = 0; i < SAMPLES; i++) histogram_add(&h, samples[i]);
    histogram_bins(&h, bins);
    for (int i = 0; i < SAMPLES; i++) {
        int k = 0;
        while (k < HISTOGRAM_BINS - 1 && 1e-3 * (double)samples[i] >= pow(2.0, 0.5 * k)) k++;
        expected[k]++;
    }
    int32_t total = 0;
    for (int k = 0; k < HISTOGRAM_BINS; k++) {
        assert_true(abs(bins[k] - expected[k]) <= 0.12 * SAMPLES / HISTOGRAM_BINS); /* a bucket may straddle two bins */
        total += bins[k];
    }
    assert_int_equal(total, SAMPLES);
}

static void clearing_empties(void **unused) {
    (void)unused;
    static int64_t samples[SAMPLES];
    static histogram all, empty;
    draw(samples);
    for (int i = 0; i < SAMPLES; i++) histogram_add(&all, samples[i]);
    histogram_clear(&all);
    assert_memory_equal(&all, &empty, sizeof all);
}

static void sleeps_until_the_time_given(void **unused) {
    (void)unused;
    int64_t start = monotonic_ns(), wall = wall_us();
    sleep_until(start + 20000000);
    int64_t passed = monotonic_ns() - start;
    assert_true(passed >= 20000000);
    assert_true(llabs((wall_us() - wall) * 1000 - passed) < 1000000000); /* over the elapsed time, the two clocks agree to within one second */
    sleep_until(start); /* already past, so the call returns at once */
}

static void usage_counts_page_faults(void **unused) {
    (void)unused;
    enum { PAGES = 64 };
    thread_usage before = thread_usage_now();
    char *memory = mmap(NULL, PAGES * 4096, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    madvise(memory, PAGES * 4096, MADV_NOHUGEPAGE);
    memset(memory, 1, PAGES * 4096);
    thread_usage after = thread_usage_now();
    munmap(memory, PAGES * 4096);
    assert_true(after.minor_faults - before.minor_faults >= PAGES);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(quantiles_agree_with_sorting), cmocka_unit_test(extremes_are_kept),
        cmocka_unit_test(bins_contain_values_between_their_edges),
        cmocka_unit_test(clearing_empties),        cmocka_unit_test(sleeps_until_the_time_given),
        cmocka_unit_test(usage_counts_page_faults),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
