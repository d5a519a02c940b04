/* A vector as wide as the target's registers: eight doubles (AVX-512) or four (one AVX2 register, or two NEON registers). For loops that are compiled once for
   each width. */
#ifndef TROCAR_SIMD_WIDE_H
#define TROCAR_SIMD_WIDE_H

#include <stdbool.h>
#include <string.h>

#ifdef __AVX512F__
enum { SIMD_WIDE_WIDTH = 8 };
#else
enum { SIMD_WIDE_WIDTH = 4 };
#endif

typedef double simd_wide __attribute__((vector_size(SIMD_WIDE_WIDTH * sizeof(double))));

static inline simd_wide simd_wide_load(const double *from) {
    simd_wide x;
    memcpy(&x, from, sizeof x); /* `from` need not be aligned */
    return x;
}

static inline void simd_wide_store(double *to, simd_wide x) { memcpy(to, &x, sizeof x); }
static inline simd_wide simd_wide_all(double x) { return x - (simd_wide){0}; }

static inline simd_wide simd_wide_from(int i) {
    simd_wide x;
    for (int k = 0; k < SIMD_WIDE_WIDTH; k++) x[k] = i + k;
    return x;
}

/* Returns x in the lanes where the mask (the result of a comparison) is true, and zero elsewhere. */
typedef __typeof__((simd_wide){0} < (simd_wide){0}) simd_wide_mask;
static inline simd_wide simd_wide_where(simd_wide_mask mask, simd_wide x) { return (simd_wide)(mask & (simd_wide_mask)x); }

/* Returns the largest multiple of SIMD_WIDE_WIDTH that is at most i, for i >= 0. */
static inline int simd_wide_below(int i) { return i / SIMD_WIDE_WIDTH * SIMD_WIDE_WIDTH; }

#ifdef TROCAR_AVX512 /* defined if the program contains code for x86-64-v4 besides the portable code */

/* True if this processor supports x86-64-v4 and the portable code uses fused multiply-add. Without fused multiply-add, the two versions would give different
   results. RT */
static inline bool runs_avx512(void) {
#ifdef __FMA__
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd")
        && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
#else
    return false;
#endif
}

#endif

#endif
