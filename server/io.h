/* The IO thread: the only thread that receives messages and publishes wrenches. */
#ifndef TROCAR_IO_H
#define TROCAR_IO_H

#include <lcm/lcm.h>
#include <semaphore.h>

#include "exchange.h"
#include "intake/pose_arbiter.h"
#include "intake/probe_arbiter.h"
#include "lcm_filter.h"

/* The channels to which the thread subscribes; the packet filter may drop all others. */
extern const packet_wishes IO_PACKETS;

typedef struct {
    exchange *exchange;
    const char *url;             /* LCM URL; NULL for LCM's default */
    int64_t server;              /* this server's number, set by the creator */
    bool realtime;               /* under SCHED_FIFO */
    int shutdown_wake;           /* eventfd signalled when a client requests a shutdown or the network fails */
    sem_t ready;                 /* posted once, when the thread is listening or has failed */
    atomic_bool stop;
    trocar_status started;       /* valid after `ready` */
    trocar_status status;        /* valid after the thread has ended; only the thread uses this and all following members */
    report why;                  /* reason of `status`, and of `started` if that is a failure */
    lcm_t *lcm;
    pose_arbiter arbiter;
    probe_arbiter probe;
    bool probe_stopped;      /* the tissue stops the probe, and the user has been told */
    int64_t wrenches_unsent;     /* number of wrenches that the network refused */
} io;

trocar_status io_create(io *o, const char *url, int needle_count, const trocar_device_limits *limits, bool realtime, int shutdown_wake,
                        exchange *x, report *why);
void io_free(io *o);

/* Body of the thread; `context` is an io. LCM's hidden reader thread inherits its priority. */
void *io_run(void *context);

/* Ends the thread once it has published the wrenches in the ring. */
void io_stop(io *o);

/* io_open connects and subscribes. io_round receives all messages that have arrived and publishes all pending wrenches. Both are for io_run and
   tests. */
trocar_status io_open(io *o);
trocar_status io_round(io *o);
void io_close(io *o);

#endif
