/* One tick of the server. Each needle's data flow like this: newest pose -> safety limits -> simulation -> safety limits -> wrench. */
#ifndef TROCAR_HAPTIC_H
#define TROCAR_HAPTIC_H

#include "common/handover.h"
#include "coupling/virtual_coupling.h"
#include "exchange.h"
#include "intake/safety_limits.h"
#include "loop.h"

/* State of one needle. A needle without an owner, or whose device is silent, does not affect the others. */
typedef struct {
    safety_limits safety;
    virtual_coupling coupling;
    int64_t saturated_ticks;     /* since start */
    bool rests;                  /* left in the tissue and not picked up since, so it is not ticked */
    bool faulty;                 /* the last tick gave no reliable wrench */
    vec3 force;                  /* N, the model's force in the last tick */
    bool taken;                  /* picked up where it rested, so engaging it does not start a new insertion */
    bool pending;                /* `command` is in progress for this needle */
    needle_command command;
    hand_clutch clutch;          /* offset between a needle that was picked up and the hand that did so */
} haptic_needle;

typedef struct {
    trocar_sim *sim;             /* only the haptic thread ticks it */
    int needle_count;
    trocar_device_limits limits;
    double period;               /* s, nominal */
    int flags;                   /* set in every wrench: NOT_REALTIME or 0 */
    int64_t server;              /* ID of this server, set by the creator of this struct */
    exchange *exchange;
    atomic_bool wind_down;       /* any thread may set this to ramp the wrenches to zero and then stop the loop */

    haptic_needle needles[TROCAR_MAX_NEEDLES]; /* from here on, used only by the haptic thread */
    int64_t probe_session, probe_seq; /* session and sequence number of the probe's last pose; -1 before the first */
    trocar_probe probe;          /* the probe's state as last sent */
    int64_t wrench_dropped;      /* since start */
    int64_t stages[LOOP_STAGES]; /* ns, how long each stage of the last tick took, summed over the needles */
    needle_command later;        /* a change of moduli that must wait until the previous one is complete; if none, `change` is NULL */
    int64_t received;            /* ns, monotonic: arrival of the newest held needle's pose used in the last tick; 0 if there was none */
} haptic;

/* Sets up the loop's state for `needle_count` needles, and makes the simulation use the monotonic clock. `sim` and `x` must outlive it. */
void haptic_init(haptic *h, trocar_sim *sim, int needle_count, const trocar_device_limits *limits, double rate_hz, int flags, exchange *x);

/* Does one tick. `context` is a haptic. Returns false once the wrenches have been ramped down to zero after `wind_down`. RT */
bool haptic_tick(void *context, const loop_wake *wake);

#endif
