/* A vector as wide as the registers of the compilation target: eight doubles (AVX-512) or four (AVX2, or two NEON registers). For loops that are compiled once
   for each width. */
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
    memcpy(&x, from, sizeof x); /* need not be aligned */
    return x;
}

static inline void simd_wide_store(double *to, simd_wide x) { memcpy(to, &x, sizeof x); }
static inline simd_wide simd_wide_all(double x) { return x - (simd_wide){0}; }

static inline simd_wide simd_wide_from(int i) {
    simd_wide x;
    for (int k = 0; k < SIMD_WIDE_WIDTH; k++) x[k] = i + k;
    return x;
}

/* x in the lanes where the mask, a comparison, is true, and zero in the others. */
typedef __typeof__((simd_wide){0} < (simd_wide){0}) simd_wide_mask;
static inline simd_wide simd_wide_where(simd_wide_mask mask, simd_wide x) { return (simd_wide)(mask & (simd_wide_mask)x); }

/* The largest multiple of SIMD_WIDE_WIDTH that is at most i, for i >= 0. */
static inline int simd_wide_below(int i) { return i / SIMD_WIDE_WIDTH * SIMD_WIDE_WIDTH; }

#ifdef TROCAR_AVX512 /* the program has code for x86-64-v4 besides that for any other processor */

/* True if this processor supports x86-64-v4. Results are equal to the bit only if both versions have fused multiplication. RT */
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
