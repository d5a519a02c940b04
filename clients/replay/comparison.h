/* Compares the wrenches of a replay, as they are computed, with golden wrenches from an earlier run of the same poses. */
#ifndef TROCAR_COMPARISON_H
#define TROCAR_COMPARISON_H

#include <stdio.h>

#include "shared/poselog.h"

enum { WRENCH_COMPONENTS = 6 }; /* force x, y, z and torque x, y, z */

/* The component in which a golden wrench differs most from the replayed one. */
typedef struct {
    trocar_needle_wrench_t golden, replayed;
    int component;
    double time;             /* s since the first pose */
    double off;              /* N or N m, how far the golden value lies outside the range of the replay */
    double share;            /* `off` as a fraction of the component's peak in the golden log */
} deviation;

enum { SHARE_BINS = 1001 };

typedef struct {
    int compared, differing; /* golden wrenches compared, and how many of them differ */
    int foreign;             /* golden wrenches ignored because they came from another server than the first one */
    int unrecorded;          /* golden wrenches ignored because the recording lacks the poses that they answer */
    deviation first;         /* the first that exceeds the tolerance */
    deviation largest, last;
    /* histogram of deviation.share over the compared golden wrenches: bin i counts values from 0.001 i to 0.001 (i + 1), the last bin also all larger ones */
    int bins[SHARE_BINS];
    int64_t skipped_not_finite; /* golden wrenches skipped because they are not finite */
    char inverse[16];        /* type of inverse named in the golden log; empty if unknown */
    /* state of the comparison */
    const char *path;        /* path of the golden log */
    double tolerance, peaks[WRENCH_COMPONENTS];
    int64_t session, first_utime;
    wrench_stream *stream;
    bool begun, ended;       /* `begun`: the session's first golden wrench has been read; `ended`: none are left */
    int64_t server;          /* the one that sent the first golden wrench */
    trocar_needle_wrench_t golden; /* the next golden wrench to compare */
    trocar_needle_wrench_t window[3]; /* replayed wrenches before, at and after the one to compare */
    int replayed;            /* replayed wrenches so far */
} comparison;

/* Reads the golden log once to find the peak of each component. `session` is the session of the replayed poses. Returns BAD_INPUT if the log is unusable, or if
   its wrenches of that session are not in the order of their poses; NO_MEMORY if out of memory. After an error, call only comparison_free. */
trocar_status comparison_begin(comparison *c, const char *golden_path, int64_t session, double tolerance, trocar_error *why);

/* Compares the golden wrenches that answer this pose; call it with the replayed wrenches in the order of their poses. Each raw component of a golden wrench
   must lie in the range of the replayed values at its pose and the poses before and after, give or take `tolerance`, a fraction of the component's peak (which
   counts as at least 0.1 N or 2 mN m). The tolerance is needed because other processors and BLAS kernels round differently, which may shift contact events by a
   tick. Ignores golden wrenches from other sessions or from a second server, and those whose pose was not replayed because the recording began later or lost
   it. Poses without a golden wrench are fine. */
trocar_status comparison_add(comparison *c, const trocar_needle_wrench_t *replayed, trocar_error *why);

/* Call it after the last wrench. Returns BAD_INPUT if a golden wrench answers a later pose, if most of the poses are missing, or if no wrench was compared. */
trocar_status comparison_end(comparison *c, trocar_error *why);
void comparison_free(comparison *c);

/* Returns the quantile q of deviation.share over the compared golden wrenches, with a resolution of 0.001. */
double comparison_quantile(const comparison *c, double q);

/* Prints the result of the comparison. */
void comparison_print(const comparison *c, FILE *out);

#endif
