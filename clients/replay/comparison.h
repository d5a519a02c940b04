/* Compares the wrenches of a replay, as they arrive, with golden wrenches from an earlier run of the same poses. */
#ifndef TROCAR_COMPARISON_H
#define TROCAR_COMPARISON_H

#include <stdio.h>

#include "shared/poselog.h"

enum { WRENCH_COMPONENTS = 6 }; /* force x, y, z and torque x, y, z */

/* The component of a golden wrench that differs most from the replayed one. */
typedef struct {
    trocar_needle_wrench_t golden, replayed;
    int component;
    double time;             /* s since the first pose */
    double off;              /* N or N m, distance from the range of the replay */
    double share;            /* difference as a fraction of the component's peak in the golden log */
} deviation;

enum { SHARE_BINS = 1001 };

typedef struct {
    int compared, differing; /* number of golden wrenches that were compared, and of those that differ */
    int foreign;             /* number of golden wrenches ignored because they came from a different server than the first golden wrench */
    int unrecorded;          /* number of golden wrenches ignored because the recording does not contain the poses that they answer */
    deviation first;         /* first difference that exceeds the tolerance */
    deviation largest, last;
    /* histogram of deviation.share over the compared golden wrenches: bin i counts values from 0.001 i to 0.001 (i + 1); the last bin also counts all
       larger ones */
    int bins[SHARE_BINS];
    int64_t skipped_not_finite; /* number of golden wrenches skipped because they are not finite */
    char inverse[16];        /* type of inverse according to the golden log; empty if unknown */
    /* State during the comparison */
    const char *path;        /* path of the golden log */
    double tolerance, peaks[WRENCH_COMPONENTS];
    int64_t session, first_utime;
    wrench_stream *stream;
    bool begun, ended;       /* `begun`: a golden wrench of the session has been read; `ended`: none are left */
    int64_t server;          /* server that sent the first golden wrench */
    trocar_needle_wrench_t golden; /* the next golden wrench to compare */
    trocar_needle_wrench_t window[3]; /* replayed wrenches before, at and after the compared wrench */
    int replayed;            /* number of replayed wrenches so far */
} comparison;

/* Reads the golden log once to find the peak of each component. `session` is the session of the replayed poses. BAD_INPUT for an unusable log, and
   for a log whose wrenches of that session are not in the order of their poses; NO_MEMORY. After any of these errors, call only comparison_free. */
trocar_status comparison_begin(comparison *c, const char *golden_path, int64_t session, double tolerance, trocar_error *why);

/* Compares the raw wrenches, which must be passed in the order of their poses. A golden component may differ from the range of the replay at the
   answered pose and its neighbours by `tolerance`, a fraction of its peak (at least 0.1 N or 2 mN m). The tolerance is needed because other
   processors and BLAS kernels round differently, which shifts contact events by a tick. Ignores golden wrenches of other sessions, of servers other
   than that of the first compared wrench, and those whose pose was not replayed because the recording began later or lost it. There may be fewer
   golden wrenches than poses. */
trocar_status comparison_add(comparison *c, const trocar_needle_wrench_t *replayed, trocar_error *why);

/* Must be called after the last wrench. BAD_INPUT if a golden wrench answers a later pose, if most poses are missing, or if no wrench was
   compared. */
trocar_status comparison_end(comparison *c, trocar_error *why);
void comparison_free(comparison *c);

/* Returns the quantile q of the differences (deviation.share) of the compared golden wrenches, with a resolution of 0.001. */
double comparison_quantile(const comparison *c, double q);

/* Prints the result of the comparison. */
void comparison_print(const comparison *c, FILE *out);

#endif
