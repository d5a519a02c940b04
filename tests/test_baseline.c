/* The yardstick: it multiplies, every time, in one thread. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <time.h>

#include "baseline.h"

/* No core does more than 64 floating-point operations a cycle, nor 6e9 cycles a second: faster would be no product. */
static void takes_the_time_of_a_product(void **state) {
    (void)state;
    histogram time;
    baseline_measure(&time);
    double operations = 2.0 * BASELINE_ORDER * BASELINE_ORDER * BASELINE_ORDER;
    assert_true(histogram_quantile(&time, 0.5) > operations / (64 * 6e9));
}

/* Processor time counts all threads: a second one would show as more than the time that passed. */
static void uses_one_thread(void **state) {
    (void)state;
    histogram time;
    int64_t start = monotonic_ns();
    clock_t processor = clock();
    baseline_measure(&time);
    double used = (double)(clock() - processor) / CLOCKS_PER_SEC, passed = 1e-9 * (double)(monotonic_ns() - start);
    assert_true(used <= 1.1 * passed + 0.01);
    assert_true(histogram_quantile(&time, 0.5) * 0.5 * (double)time.count <= passed);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(takes_the_time_of_a_product),
        cmocka_unit_test(uses_one_thread),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
