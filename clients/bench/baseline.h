/* A baseline for benchmarks: the time of a matrix product on the same machine, measured in the same run. */
#ifndef TROCAR_BASELINE_H
#define TROCAR_BASELINE_H

#include "common/timing.h"

enum { BASELINE_ORDER = 256 };

/* Repeatedly times the product of two square matrices of order BASELINE_ORDER (cblas_dgemm, one thread). Sets OpenBLAS to one
   thread for the whole process. */
void baseline_measure(histogram *time);

/* Returns the ratio of the median of `time` to the median of the baseline. */
double per_baseline(const histogram *baseline, const histogram *time);

#endif
