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
    int foreign;             /* golden wrenches of other servers than the first one's, ignored */
    int unrecorded;          /* golden wrenches that answer poses which the recording missed, ignored */
    deviation first;         /* the first beyond the tolerance; undefined if none differs */
    deviation largest;
    deviation last;          /* of the last golden wrench */
    int bins[SHARE_BINS];    /* golden wrenches by share: bin k from k/1000 of the peak on, the last one open-ended */
} comparison;

/* Compares the raw wrenches; `replayed` (count) are in the order of their poses. A golden component may differ by `tolerance` (a
   share of its peak, which counts as at least 0.1 N or 2 mN m) from the range of the replay at the answered pose and its
   neighbours, because other processors and BLAS kernels round differently, which shifts contact events by a tick. Golden wrenches
   of other sessions and of other servers than that of the first compared one are ignored, as are those whose pose is missing among
   the replayed ones, because the recording began after it or lost it; there may be fewer than poses. BAD_INPUT if one answers a
   pose after the last replayed one, if most poses are missing, or if none is left. */
trocar_status compare_wrenches(const wrench_log *golden, const char *golden_path, const trocar_needle_wrench_t *replayed,
                               int count, double tolerance, comparison *c, report *why);

/* Quantile q of the golden wrenches' shares, to 0.001. */
double comparison_quantile(const comparison *c, double q);

/* Prints the result of compare_wrenches. */
void comparison_print(const comparison *c, const wrench_log *golden, const char *golden_path,
                      const trocar_needle_wrench_t *replayed, FILE *out);

#endif
