/* Four doubles at once, by the compiler's vector types: one AVX2 register, or two of NEON. */
#ifndef TROCAR_LANES_H
#define TROCAR_LANES_H

#include <string.h>

enum { LANES = 4 };

typedef double lanes __attribute__((vector_size(LANES * sizeof(double))));
typedef int int_lanes __attribute__((vector_size(LANES * sizeof(int))));

static inline lanes lanes_load(const double *from) {
    lanes x;
    memcpy(&x, from, sizeof x); /* need not be aligned */
    return x;
}

static inline void lanes_store(double *to, lanes x) { memcpy(to, &x, sizeof x); }
static inline lanes lanes_all(double x) { return (lanes){x, x, x, x}; }
static inline lanes lanes_from(int i) { return lanes_all(i) + (lanes){0, 1, 2, 3}; }
static inline double lanes_sum(lanes x) { return (x[0] + x[2]) + (x[1] + x[3]); }

/* x where the mask, a comparison of lanes, is true, and zero in the other lanes. */
typedef __typeof__((lanes){0} < (lanes){0}) lanes_mask;
static inline lanes lanes_where(lanes_mask mask, lanes x) { return (lanes)(mask & (lanes_mask)x); }

/* The largest multiple of LANES that is not above i >= 0. */
static inline int lanes_below(int i) { return i / LANES * LANES; }

#endif
