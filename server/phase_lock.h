/* Locks the phase of the haptic loop to the device, so that each tick begins just after a pose has arrived instead of up to a period later. It is a
   first-order loop: each deadline is shifted by a small part of the error, at most 1 % of the period. Model time still advances in whole periods, so
   it differs from the clock by the sum of these shifts. No clock: times are arguments. */
#ifndef TROCAR_PHASE_LOCK_H
#define TROCAR_PHASE_LOCK_H

#include <stdint.h>

typedef struct {
    int64_t period;          /* ns, period of the loop */
    int64_t received;        /* ns, monotonic: arrival of the last pose taken into account; 0 before the first */
    double jitter;           /* ns, mean deviation of the poses' arrival from the expected time */
} phase_lock;

/* Returns by how much (ns) the next deadline should differ from one period after `deadline`; positive is later. `received` is the arrival of the
   newest pose at the deadline, 0 if there is none. RT */
int64_t phase_lock_shift(phase_lock *p, int64_t deadline, int64_t received);

#endif
