#include "phase_lock.h"

#include <math.h>

static const double LEAST_MARGIN = 40e3; /* ns, minimum time between a pose's arrival and the tick; the IO thread needs it to pass the pose on */
static const double JITTERS = 3.0;       /* margin for jitter, in multiples of the mean deviation of the arrival times */
static const double MOST_MARGIN = 0.25;  /* maximum margin, as a fraction of the period */
static const double GAIN = 0.05;         /* fraction of the phase error corrected per tick */
static const double MOST_SHIFT = 0.01;   /* maximum shift of a deadline, as a fraction of the period */
static const double MEAN = 0.02;         /* weight of the newest deviation in the running mean */

int64_t phase_lock_shift(phase_lock *p, int64_t deadline, int64_t received) {
    if (received == 0 || received == p->received) return 0;
    double period = (double)p->period, margin = fmin(LEAST_MARGIN + JITTERS * p->jitter, MOST_MARGIN * period);
    double error = remainder((double)(deadline - received) - margin, period); /* a pose that just misses a tick is used one period later */
    p->received = received;
    p->jitter += MEAN * (fmin(fabs(error), MOST_MARGIN * period) - p->jitter);
    return (int64_t)(-fmax(-MOST_SHIFT * period, fmin(GAIN * error, MOST_SHIFT * period)));
}
