/* Compares the wrenches of a replay with golden ones from an earlier run of the same poses. */
#ifndef TROCAR_COMPARISON_H
#define TROCAR_COMPARISON_H

#include "poselog.h"

/* The component of a golden wrench that differs most from the replayed one. */
typedef struct {
    int golden, replayed;    /* indices */
    int component;           /* 0..5: force x y z, torque x y z */
    double off;              /* N or N m */
    double share;            /* of the component's peak in the golden log */
} deviation;

enum { SHARE_BINS = 1001 };

typedef struct {
    int compared, differing; /* golden wrenches */
    int foreign;             /* golden wrenches left out: of another server than the first one's */
    deviation first;         /* beyond the tolerance; meaningless if none differs */
    deviation largest;
    deviation last;          /* of the last golden wrench */
    int bins[SHARE_BINS];    /* golden wrenches by share: bin k those from k/1000 of the peak, the last one also the rest */
} comparison;

/* Compares the raw wrenches; `replayed` (count) are in the order of their poses. A golden component may be off by `tolerance`
   (a share of its peak, taken as 0.1 N or 2 mN m where that is more) from the range that the replay has at the pose it
   answers and the ones beside it: other processors and BLAS kernels round otherwise, which moves contact events by a tick.
   Golden wrenches of other sessions are passed over, and of all servers but that of the first one compared; there may be fewer than poses. BAD_INPUT if one answers a pose that
   was not replayed, or none is left. */
trocar_status compare_wrenches(const wrench_log *golden, const char *golden_path, const trocar_needle_wrench_t *replayed,
                               int count, double tolerance, comparison *c, report *why);

/* The share that a part q of the golden wrenches does not pass, to 0.001. */
double comparison_quantile(const comparison *c, double q);

/* Prints what compare_wrenches found. */
void comparison_print(const comparison *c, const wrench_log *golden, const char *golden_path,
                      const trocar_needle_wrench_t *replayed, FILE *out);

#endif
