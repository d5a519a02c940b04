/* A baseline for benchmarks: the time of a matrix product on this machine, in this run. */
#ifndef TROCAR_BASELINE_H
#define TROCAR_BASELINE_H

#include "common/timing.h"

enum { BASELINE_ORDER = 256 };

/* Times the product of two square matrices of BASELINE_ORDER (cblas_dgemm, one thread) repeatedly. Sets OpenBLAS to one thread for
   the whole process. */
void baseline_measure(histogram *time);

/* Ratio of the medians. */
double per_baseline(const histogram *baseline, const histogram *time);

#endif
