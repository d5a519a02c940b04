/* Tests the timing baseline, a matrix product: it is really computed every time, and in a single thread. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <cblas.h>

#include "bench/baseline.h"

/* No core does more than 64 floating-point operations per cycle at more than 6e9 cycles per second. A shorter time means that the product was not computed. */
static void measures_the_time_of_a_matrix_product(void **state) {
    (void)state;
    histogram time;
    baseline_measure(&time);
    double operations = 2.0 * BASELINE_ORDER * BASELINE_ORDER * BASELINE_ORDER;
    assert_true(histogram_quantile(&time, 0.5) > operations / (64 * 6e9));
}

static void restores_one_thread(void **state) {
    (void)state;
    histogram time;
    openblas_set_num_threads(2);
    assert_int_equal(openblas_get_num_threads(), 2);
    baseline_measure(&time);
    assert_int_equal(openblas_get_num_threads(), 1);
}

/* Half of the products took at least the median time, and together they cannot have taken longer than the elapsed time. */
static void times_do_not_exceed_elapsed_time(void **state) {
    (void)state;
    histogram time;
    int64_t start = monotonic_ns();
    baseline_measure(&time);
    double passed = 1e-9 * (double)(monotonic_ns() - start);
    assert_true(histogram_quantile(&time, 0.5) * 0.5 * (double)time.count <= passed);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(measures_the_time_of_a_matrix_product),
        cmocka_unit_test(restores_one_thread),
        cmocka_unit_test(times_do_not_exceed_elapsed_time),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
