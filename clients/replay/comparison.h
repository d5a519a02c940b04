/* Compares the wrenches of a replay with golden ones from an earlier run of the same poses, one by one as they arrive. */
#ifndef TROCAR_COMPARISON_H
#define TROCAR_COMPARISON_H

#include <stdio.h>

#include "shared/poselog.h"

enum { WRENCH_COMPONENTS = 6 }; /* force x y z, torque x y z */

/* The component of a golden wrench that differs most from the replayed one. */
typedef struct {
    trocar_needle_wrench_t golden, replayed;
    int component;
    double time;             /* s after the first pose */
    double off;              /* N or N m */
    double share;            /* fraction of the component's peak in the golden log */
} deviation;

enum { SHARE_BINS = 1001 };

typedef struct {
    int compared, differing; /* golden wrenches */
    int foreign;             /* number of golden wrenches ignored because they come from another server than the first one */
    int unrecorded;          /* number of golden wrenches ignored because the recording missed the poses they answer */
    deviation first;         /* difference beyond the tolerance */
    deviation largest, last;
    int bins[SHARE_BINS];    /* golden wrenches by fraction: bin i from 0.001 i on; the last one also counts all above */
    int64_t skipped_not_finite; /* golden wrenches */
    char inverse[16];        /* kind of inverse according to the golden log; empty: unknown */
    /* State during the comparison: */
    const char *path;        /* of the golden log */
    double tolerance, peaks[WRENCH_COMPONENTS];
    int64_t session, first_utime;
    wrench_stream *stream;
    bool begun, ended;       /* a golden wrench of the session has been read; none is left */
    int64_t server;          /* of the first one */
    trocar_needle_wrench_t golden; /* the next one to compare */
    trocar_needle_wrench_t window[3]; /* of the replay: before, at and after the compared wrench */
    int replayed;            /* wrenches so far */
} comparison;

/* Reads the golden log once, for the peaks of its components. The session is that of the replayed poses. BAD_INPUT for an unusable log, or one whose
   wrenches of that session are not in the order of their poses; NO_MEMORY. After any of these, call only comparison_free. */
trocar_status comparison_begin(comparison *c, const char *golden_path, int64_t session, double tolerance, report *why);

/* Compares the raw wrenches, which come in the order of their poses. A golden component may differ by `tolerance` (a fraction of its peak, which
   counts as at least 0.1 N or 2 mN m) from the range of the replay at the answered pose and its neighbours, because other processors and BLAS kernels
   round differently, which shifts contact events by a tick. Ignores golden wrenches of other sessions, of servers other than that of the first
   compared one, and those whose pose is missing among the replayed ones because the recording began after it or lost it. There may be fewer golden
   wrenches than poses. */
trocar_status comparison_add(comparison *c, const trocar_needle_wrench_t *replayed, report *why);

/* Call after the last one. BAD_INPUT if a golden wrench answers a later pose, if most poses are missing, or if none was compared. */
trocar_status comparison_end(comparison *c, report *why);
void comparison_free(comparison *c);

/* Quantile q of the golden wrenches' fractions, to 0.001. */
double comparison_quantile(const comparison *c, double q);

/* Prints the result. */
void comparison_print(const comparison *c, FILE *out);

#endif
