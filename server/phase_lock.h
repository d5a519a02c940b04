/* Ties the phase of the haptic loop to the device's: each tick begins just after a pose has come, and not up to a period later. A loop of the
   first order: it shifts deadlines by a small part of the error, at most 1 % of the period, by which the model's time, in steps of a period, then
   differs from the clock's. No clock: times are arguments. */
#ifndef TROCAR_PHASE_LOCK_H
#define TROCAR_PHASE_LOCK_H

#include <stdint.h>

typedef struct {
    int64_t period;          /* ns, of the loop */
    int64_t received;        /* ns, monotonic: arrival of the last pose taken into account; 0 before the first */
    double jitter;           /* ns, mean deviation of poses from where they are expected */
} phase_lock;

/* By how much (ns) the next deadline is to be later than a period after this one. `received` is when the newest pose came that was there at
   the deadline; 0: none. RT */
int64_t phase_lock_shift(phase_lock *p, int64_t deadline, int64_t received);

#endif
