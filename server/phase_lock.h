/* Locks the phase of the haptic loop to the device: each tick begins just after a pose has come, instead of up to a period later. A first-order loop:
   it shifts deadlines by a small part of the error, at most 1 % of the period. Model time advances in whole periods and so differs from the clock's
   by that. No clock: times are arguments. */
#ifndef TROCAR_PHASE_LOCK_H
#define TROCAR_PHASE_LOCK_H

#include <stdint.h>

typedef struct {
    int64_t period;          /* ns, of the loop */
    int64_t received;        /* ns, monotonic: arrival of the last pose taken into account; 0 before the first */
    double jitter;           /* ns, mean deviation of poses from their expected time */
} phase_lock;

/* Returns how much later than one period after this one the next deadline should be, ns. `received`: arrival of the newest pose at the deadline; 0:
   none. RT */
int64_t phase_lock_shift(phase_lock *p, int64_t deadline, int64_t received);

#endif
