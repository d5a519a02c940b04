/* A baseline for benchmarks: the time that a matrix product takes on the same machine in the same run. */
#ifndef TROCAR_BASELINE_H
#define TROCAR_BASELINE_H

#include "common/timing.h"

enum { BASELINE_ORDER = 256 };

/* Times the product of two square matrices of order BASELINE_ORDER many times (cblas_dgemm, one thread). Limits OpenBLAS to one thread in the whole process. */
void baseline_measure(histogram *time);

/* Returns the median of `time` divided by the median of the baseline. */
double per_baseline(const histogram *baseline, const histogram *time);

#endif
