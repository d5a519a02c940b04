/* One tick of the server: newest pose -> safety limits -> model -> safety limits -> wrench. */
#ifndef TROCAR_HAPTIC_H
#define TROCAR_HAPTIC_H

#include "exchange.h"
#include "safety_limits.h"
#include "loop.h"
#include "virtual_coupling.h"

enum { REQUESTS_REMEMBERED = 1024 };

typedef struct {
    const insertion_model *model;
    insertion_workspace *scratch;
    device_limits limits;
    double period;               /* s, nominal */
    int flags;                   /* that every wrench carries: NOT_REALTIME or 0 */
    int64_t server;              /* number of this server; its creator's to set */
    exchange *exchange;
    atomic_bool wind_down;       /* set by any thread: ramp to zero, then end */

    insertion_state *state;      /* all below: the haptic thread's own */
    safety_limits safety;
    virtual_coupling coupling;
    uint64_t posted;             /* serial of the last request handed to the worker */
    int64_t asked[REQUESTS_REMEMBERED]; /* ns, when the request of this serial (modulo) was handed over */
    int64_t wrench_dropped, saturated_ticks; /* since start */
    int64_t stages[LOOP_STAGES]; /* ns, of the last tick */
} haptic;

/* `model`, `scratch` and `x` must outlive it; `scratch` is used by nobody else. */
trocar_status haptic_create(haptic *h, const insertion_model *model, insertion_workspace *scratch, const device_limits *limits,
                            double rate_hz, int flags, exchange *x, report *why);
void haptic_free(haptic *h);

/* A loop's tick; `context` is a haptic. False once it has wound down. RT */
bool haptic_tick(void *context, const loop_wake *wake);

#endif
