#include "bench/baseline.h"

#include <cblas.h>

enum { WARM_UP = 20, REPEATS = 200 };

static double a[BASELINE_ORDER][BASELINE_ORDER], b[BASELINE_ORDER][BASELINE_ORDER], c[BASELINE_ORDER][BASELINE_ORDER];

static void multiply(void) {
    const int n = BASELINE_ORDER;
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, n, n, n, 1.0, *a, n, *b, n, 0.0, *c, n);
}

void baseline_measure(histogram *time) {
    openblas_set_num_threads(1);
    for (int i = 0; i < BASELINE_ORDER; i++)
        for (int j = 0; j < BASELINE_ORDER; j++) a[i][j] = b[j][i] = 1.0 / (1 + i + j);
    for (int i = 0; i < WARM_UP; i++) multiply();
    histogram_clear(time);
    for (int i = 0; i < REPEATS; i++) {
        int64_t start = monotonic_ns();
        multiply();
        histogram_add(time, monotonic_ns() - start);
    }
}

double per_baseline(const histogram *baseline, const histogram *time) { return histogram_quantile(time, 0.5) / histogram_quantile(baseline, 0.5); }
