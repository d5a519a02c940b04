/* Locks the phase of the haptic loop to the device, so that each tick begins just after a pose has arrived, not up to one period later. This is a first-order
   control loop: each deadline is shifted by a small fraction of the phase error, and by no more than 1 % of the period. Model time still advances in whole
   periods, so it drifts from the clock by the sum of the shifts. Doesn't read a clock: times are passed in. */
#ifndef TROCAR_PHASE_LOCK_H
#define TROCAR_PHASE_LOCK_H

#include <stdint.h>

typedef struct {
    int64_t period;          /* ns, period of the loop */
    int64_t received;        /* ns, monotonic: arrival of the last pose considered; 0 before the first */
    double jitter;           /* ns, mean deviation of the arrival times from those expected */
} phase_lock;

/* Returns by how much (ns) to shift the next deadline, which would otherwise be one period after `deadline`. Positive means later. `received`: arrival of the
   newest pose known at the deadline; 0 if none. RT */
int64_t phase_lock_shift(phase_lock *p, int64_t deadline, int64_t received);

#endif
