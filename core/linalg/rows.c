#include "linalg/rows.h"

#include "linalg/simd4.h"

_Static_assert((int)ROW_STEP == SIMD4_WIDTH, "a step is a vector");

void row_copy(const double *from, int begin, int end, double *to) {
    for (int j = simd4_below(begin); j < end; j += SIMD4_WIDTH) simd4_store(to + j, simd4_load(from + j));
}

void row_subtract(double factor, const double *from, int begin, int end, double *to) {
    for (int j = simd4_below(begin); j < end; j += SIMD4_WIDTH) simd4_store(to + j, simd4_load(to + j) - simd4_all(factor) * simd4_load(from + j));
}
