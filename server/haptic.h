/* One tick of the server. The data of each needle pass through these stages: newest pose -> safety limits -> simulation -> safety limits ->
   wrench. */
#ifndef TROCAR_HAPTIC_H
#define TROCAR_HAPTIC_H

#include "common/handover.h"
#include "coupling/virtual_coupling.h"
#include "exchange.h"
#include "intake/safety_limits.h"
#include "loop.h"

/* State of one needle. A needle that has no owner, or whose device is silent, does not affect the others. */
typedef struct {
    safety_limits safety;
    virtual_coupling coupling;
    int64_t saturated_ticks;     /* since start */
    bool rests;                  /* the needle was left in the tissue and has not been taken again, so it is not ticked */
    bool faulty;                 /* the last tick did not produce a reliable wrench */
    vec3 force;                  /* N, the model's force in the last tick */
    bool taken;                  /* a hand took the needle where it rested, so engaging the needle does not start a new insertion */
    bool pending;                /* `command` is being executed for this needle */
    needle_command command;
    hand_clutch clutch;          /* offset between a taken needle and the hand that took it */
} haptic_needle;

typedef struct {
    trocar_sim *sim;             /* ticked by the haptic thread only */
    int needle_count;
    trocar_device_limits limits;
    double period;               /* s, nominal */
    int flags;                   /* flags set in every wrench: NOT_REALTIME or 0 */
    int64_t server;              /* this server's ID, set by the creator of this struct */
    exchange *exchange;
    atomic_bool wind_down;       /* set by any thread to make the loop ramp the wrenches to zero and then stop */

    haptic_needle needles[TROCAR_MAX_NEEDLES]; /* this and all following members are used only by the haptic thread */
    int64_t probe_session, probe_seq; /* session and sequence number of the last pose of the probe; -1 before the first */
    trocar_probe probe;          /* state of the probe as last sent */
    int64_t wrench_dropped;      /* since start */
    int64_t stages[LOOP_STAGES]; /* ns, durations of the last tick's stages, summed over all needles */
    needle_command later;        /* a change of moduli that waits until the previous one is complete; its `change` is NULL if none is waiting */
    int64_t received;            /* ns, monotonic: arrival time of the newest pose of a held needle that the last tick used; 0 if there was none */
} haptic;

/* Prepares the loop's state for a model with `needle_count` needles, and makes the simulation use the monotonic clock. `sim` and `x` must outlive the
   loop's state. */
void haptic_init(haptic *h, trocar_sim *sim, int needle_count, const trocar_device_limits *limits, double rate_hz, int flags, exchange *x);

/* Runs one tick of the loop; `context` is a haptic. Returns false once the wrenches have been ramped to zero after `wind_down`. RT */
bool haptic_tick(void *context, const loop_wake *wake);

#endif
