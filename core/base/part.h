/* Part of a row: one vector as wide as the registers that this file is compiled for, eight doubles (AVX-512) or four (AVX2; two registers of NEON).
   For loops that are compiled once for each width. */
#ifndef TROCAR_PART_H
#define TROCAR_PART_H

#include <stdbool.h>
#include <string.h>

#ifdef __AVX512F__
enum { WIDTH = 8 };
#else
enum { WIDTH = 4 };
#endif
enum { WIDEST = 8 };

typedef double part __attribute__((vector_size(WIDTH * sizeof(double))));

static inline part part_load(const double *from) {
    part x;
    memcpy(&x, from, sizeof x); /* need not be aligned */
    return x;
}

static inline void part_store(double *to, part x) { memcpy(to, &x, sizeof x); }
static inline part part_all(double x) { return x - (part){0}; }

static inline part part_from(int i) {
    part x;
    for (int k = 0; k < WIDTH; k++) x[k] = i + k;
    return x;
}

/* x where the mask, a comparison of parts, is true, and zero in the other lanes. */
typedef __typeof__((part){0} < (part){0}) part_mask;
static inline part part_where(part_mask mask, part x) { return (part)(mask & (part_mask)x); }

/* The largest multiple of WIDTH that is not above i >= 0. */
static inline int whole_parts_below(int i) { return i / WIDTH * WIDTH; }

#ifdef TROCAR_AVX512 /* this program has code for x86-64-v4 beside that for any other processor */

/* True if this processor runs it. The bits are the same only if both have fused multiplications. RT */
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
