/* One tick of the server: newest pose -> safety limits -> simulation -> safety limits -> wrench. */
#ifndef TROCAR_HAPTIC_H
#define TROCAR_HAPTIC_H

#include "exchange.h"
#include "safety_limits.h"
#include "loop.h"
#include "virtual_coupling.h"

typedef struct {
    trocar_sim *sim;             /* ticked by the haptic thread only */
    trocar_device_limits limits;
    double period;               /* s, nominal */
    int flags;                   /* of every wrench: NOT_REALTIME or 0 */
    int64_t server;              /* number of this server; set by the creator */
    exchange *exchange;
    atomic_bool wind_down;       /* set by any thread: ramp to zero, then stop */

    safety_limits safety;        /* from here on used by the haptic thread only */
    virtual_coupling coupling;
    int64_t wrench_dropped, saturated_ticks; /* since start */
    int64_t stages[LOOP_STAGES]; /* ns, of the last tick */
} haptic;

/* `sim` and `x` must outlive it. The simulation's clock becomes the monotonic one. */
void haptic_init(haptic *h, trocar_sim *sim, const trocar_device_limits *limits, double rate_hz, int flags, exchange *x);

/* A loop's tick; `context` is a haptic. False when it has ramped to zero after `wind_down`. RT */
bool haptic_tick(void *context, const loop_wake *wake);

#endif
