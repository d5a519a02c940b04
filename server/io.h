/* The IO thread: the only one that receives messages and publishes wrenches. */
#ifndef TROCAR_IO_H
#define TROCAR_IO_H

#include <lcm/lcm.h>
#include <semaphore.h>

#include "exchange.h"
#include "intake/pose_arbiter.h"
#include "intake/probe_arbiter.h"
#include "lcm_filter.h"

/* Channels that it subscribes to; the packet filter may drop everything else. */
extern const packet_wishes IO_PACKETS;

typedef struct {
    exchange *exchange;
    const char *url;             /* of LCM, NULL: its default */
    int64_t server;              /* number of this server; set by the creator */
    bool realtime;               /* under SCHED_FIFO */
    int shutdown_wake;           /* eventfd signalled when a client requests a shutdown or the network fails */
    sem_t ready;                 /* posted once, when the thread is listening or has failed */
    atomic_bool stop;
    trocar_status started;       /* valid after `ready` */
    trocar_status status;        /* valid after the thread has ended; this and all following members are used by the thread only */
    report why;                  /* also the message for `started`, if that is a failure */
    lcm_t *lcm;
    pose_arbiter arbiter;
    probe_arbiter probe;
    bool probe_stopped;      /* the probe is stopped, and this has been reported */
    int64_t wrenches_unsent;     /* refused by the network */
} io;

trocar_status io_create(io *o, const char *url, int needle_count, const trocar_device_limits *limits, bool realtime, int shutdown_wake,
                        exchange *x, report *why);
void io_free(io *o);

/* Body of the thread; `context` is an io. LCM's hidden reader thread inherits its priority. */
void *io_run(void *context);

/* Ends the thread once the wrenches in the ring have been published. */
void io_stop(io *o);

/* Connect and subscribe; one round: receive all arrived messages and publish all pending wrenches. For io_run and tests. */
trocar_status io_open(io *o);
trocar_status io_round(io *o);
void io_close(io *o);

#endif
