/* The IO thread. No other thread receives messages or publishes wrenches. */
#ifndef TROCAR_IO_H
#define TROCAR_IO_H

#include <lcm/lcm.h>
#include <semaphore.h>

#include "exchange.h"
#include "intake/changes.h"
#include "intake/pose_arbiter.h"
#include "intake/probe_arbiter.h"
#include "lcm_filter.h"

/* The channels that the thread subscribes to. A packet filter may drop all others. */
extern const packet_wishes IO_PACKETS;

typedef struct {
    exchange *exchange;
    const char *url;             /* LCM URL; NULL for LCM's default */
    int64_t server;              /* ID of this server, set by the creator of this struct */
    bool realtime;               /* the thread runs under SCHED_FIFO */
    int shutdown_wake;           /* eventfd to signal when a client asks for a shutdown or the network fails */
    sem_t ready;                 /* posted once, when the thread is listening or has failed */
    atomic_bool stop;
    trocar_status started;       /* valid after `ready` */
    trocar_status status;        /* valid once the thread has ended; from here on, used only by the thread */
    trocar_error why;            /* explains `status`, and `started` if the start failed */
    lcm_t *lcm;
    pose_arbiter arbiter;
    probe_arbiter probe;
    change_intake changes;       /* all zero, which means that nothing can be changed, until the creator of this struct fills it */
    int64_t values_shown;        /* ns, monotonic: when the values were last published */
    int64_t wait_shown;          /* ns, monotonic: when the last change arrived, or its sender was last told to wait */
    bool probe_stopped;      /* the tissue has stopped the probe, and the user has been told */
    int64_t wrenches_unsent;     /* wrenches that could not be sent */
} io;

trocar_status io_create(io *o, const char *url, int needle_count, const trocar_device_limits *limits, bool realtime, int shutdown_wake,
                        exchange *x, trocar_error *why);
void io_free(io *o);

/* Main function of the thread. `context` is an io. LCM's hidden reader thread inherits this thread's priority. */
void *io_run(void *context);

/* Ends the thread once it has published the wrenches in the ring. */
void io_stop(io *o);

/* io_open connects and subscribes. io_round receives all messages that have arrived and publishes all pending wrenches. Only io_run and tests call these. */
trocar_status io_open(io *o);
trocar_status io_round(io *o);
void io_close(io *o);

#endif
