/* Locks the phase of the haptic loop to the device, so that each tick begins just after a pose has arrived instead of up to one period later. The
   lock is a first-order control loop: it shifts each deadline by a small fraction of the phase error, by at most 1 % of the period. Model time still
   advances in whole periods, so it differs from the clock by the sum of these shifts. The code reads no clock: times are arguments. */
#ifndef TROCAR_PHASE_LOCK_H
#define TROCAR_PHASE_LOCK_H

#include <stdint.h>

typedef struct {
    int64_t period;          /* ns, period of the loop */
    int64_t received;        /* ns, monotonic: arrival time of the last pose taken into account; 0 before the first */
    double jitter;           /* ns, mean deviation of the poses' arrival times from the expected ones */
} phase_lock;

/* Returns the time (ns) by which to shift the next deadline, which would otherwise be one period after `deadline`; a positive value means later.
   `received` is the arrival time of the newest pose known at the deadline, or 0 if there is none. RT */
int64_t phase_lock_shift(phase_lock *p, int64_t deadline, int64_t received);

#endif
