/* One tick of the server, for each needle: newest pose -> safety limits -> simulation -> safety limits -> wrench. */
#ifndef TROCAR_HAPTIC_H
#define TROCAR_HAPTIC_H

#include "common/handover.h"
#include "coupling/virtual_coupling.h"
#include "exchange.h"
#include "intake/safety_limits.h"
#include "loop.h"

/* State of one needle. A needle without owner, or with a silent device, does not affect the others. */
typedef struct {
    safety_limits safety;
    virtual_coupling coupling;
    int64_t saturated_ticks;     /* since start */
    bool rests;                  /* it is not ticked: it has been left and not taken again */
    bool faulty;                 /* the last tick had no reliable wrench */
    vec3 force;                  /* N, of the model in the last tick */
    bool taken;                  /* it is held where it rested: the next hand does not start a new insertion */
    bool pending;                /* `command` is being executed */
    needle_command command;
    hand_clutch clutch;          /* of a hand that has taken it */
} haptic_needle;

typedef struct {
    trocar_sim *sim;             /* ticked by the haptic thread only */
    int needle_count;
    trocar_device_limits limits;
    double period;               /* s, nominal */
    int flags;                   /* of every wrench: NOT_REALTIME or 0 */
    int64_t server;              /* number of this server; set by the creator */
    exchange *exchange;
    atomic_bool wind_down;       /* set by any thread: ramp to zero, then stop */

    haptic_needle needles[TROCAR_MAX_NEEDLES]; /* this and all following members are used by the haptic thread only */
    int64_t probe_session, probe_seq; /* of the probe's last pose; -1 before the first */
    trocar_probe probe;          /* as last sent */
    int64_t wrench_dropped;      /* since start */
    int64_t stages[LOOP_STAGES]; /* ns, of the last tick, sum of all needles */
    int64_t received;            /* ns, monotonic: arrival of the newest pose of a held needle, as seen by the last tick; 0: none */
} haptic;

/* `sim`, of a model with `needle_count` needles, and `x` must outlive it. Sets the simulation's clock to the monotonic one. */
void haptic_init(haptic *h, trocar_sim *sim, int needle_count, const trocar_device_limits *limits, double rate_hz, int flags, exchange *x);

/* One tick of the loop; `context` is a haptic. False once it has ramped to zero after `wind_down`. RT */
bool haptic_tick(void *context, const loop_wake *wake);

#endif
