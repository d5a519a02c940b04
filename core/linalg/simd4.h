/* Four doubles in one vector, using the compiler's vector types: one AVX2 register, or two NEON registers. */
#ifndef TROCAR_SIMD4_H
#define TROCAR_SIMD4_H

#include <string.h>

enum { SIMD4_WIDTH = 4 };

typedef double simd4 __attribute__((vector_size(SIMD4_WIDTH * sizeof(double))));

static inline simd4 simd4_load(const double *from) {
    simd4 x;
    memcpy(&x, from, sizeof x); /* `from` need not be aligned */
    return x;
}

static inline void simd4_store(double *to, simd4 x) { memcpy(to, &x, sizeof x); }
static inline simd4 simd4_all(double x) { return (simd4){x, x, x, x}; }
static inline simd4 simd4_from(int i) { return simd4_all(i) + (simd4){0, 1, 2, 3}; }
static inline double simd4_sum(simd4 x) { return (x[0] + x[2]) + (x[1] + x[3]); }

/* Returns x in the lanes where the mask (the result of a comparison) is true, and zero elsewhere. */
typedef __typeof__((simd4){0} < (simd4){0}) simd4_mask;
static inline simd4 simd4_where(simd4_mask mask, simd4 x) { return (simd4)(mask & (simd4_mask)x); }

/* Returns the largest multiple of SIMD4_WIDTH that is at most i, for i >= 0. */
static inline int simd4_below(int i) { return i / SIMD4_WIDTH * SIMD4_WIDTH; }

#endif
