/* The IO thread, which is the only thread that receives messages and publishes wrenches. */
#ifndef TROCAR_IO_H
#define TROCAR_IO_H

#include <lcm/lcm.h>
#include <semaphore.h>

#include "exchange.h"
#include "intake/changes.h"
#include "intake/pose_arbiter.h"
#include "intake/probe_arbiter.h"
#include "lcm_filter.h"

/* The channels to which the thread subscribes; a packet filter may drop all other channels. */
extern const packet_wishes IO_PACKETS;

typedef struct {
    exchange *exchange;
    const char *url;             /* LCM URL; NULL for LCM's default */
    int64_t server;              /* this server's ID, set by the creator of this struct */
    bool realtime;               /* true if the thread runs under SCHED_FIFO */
    int shutdown_wake;           /* eventfd signalled when a client requests a shutdown or the network fails */
    sem_t ready;                 /* posted once, when the thread is either listening or has failed */
    atomic_bool stop;
    trocar_status started;       /* valid after `ready` */
    trocar_status status;        /* valid after the thread has ended; this and all following members are used only by the thread */
    trocar_error why;            /* explanation of `status`, and of `started` if the start failed */
    lcm_t *lcm;
    pose_arbiter arbiter;
    probe_arbiter probe;
    change_intake changes;       /* all zero, so that nothing can be changed, until the creator of this struct fills it */
    int64_t values_shown;        /* ns, monotonic: time at which the values were last published */
    int64_t wait_shown;          /* ns, monotonic: time at which the last change arrived, or its sender was last told to wait */
    bool probe_stopped;      /* the tissue has stopped the probe, and the user has been informed */
    int64_t wrenches_unsent;     /* number of wrenches that could not be sent */
} io;

trocar_status io_create(io *o, const char *url, int needle_count, const trocar_device_limits *limits, bool realtime, int shutdown_wake,
                        exchange *x, trocar_error *why);
void io_free(io *o);

/* Main function of the thread; `context` is an io. LCM's hidden reader thread inherits this thread's priority. */
void *io_run(void *context);

/* Ends the thread after it has published the wrenches in the ring. */
void io_stop(io *o);

/* io_open connects and subscribes. io_round receives all messages that have arrived and publishes all pending wrenches. Both are called only by
   io_run and by tests. */
trocar_status io_open(io *o);
trocar_status io_round(io *o);
void io_close(io *o);

#endif
