/* Data shared by the server's threads:

               poses, commands
     IO thread  ------------->  haptic thread  <--------->  worker
     (LCM)      <-------------  (the tick)      (inside the
            wrenches, replies       |            simulation)
        | intakes                   | views, loops,            | latencies, faults
        |                           | round_trips              |
        +------------------->  telemetry thread  <-------------+
                                  (own LCM)
                                    | views
                               pictures thread

   With --listen, the IO thread also passes its messages to the relay thread, which publishes its clients' messages on an LCM connection of its own.

   Where only the newest value matters, it is passed in a triple buffer; queues are rings with one writer and one reader. See base/triple_buffer.h and
   base/spsc_ring.h. */
#ifndef TROCAR_EXCHANGE_H
#define TROCAR_EXCHANGE_H

#include <stdatomic.h>

#include "base/spsc_ring.h"
#include "base/triple_buffer.h"
#include "intake/requests.h"
#include "intake/safety_limits.h"
#include "trocar.h"

/* From the IO thread to the haptic thread: the newest pose of each needle */
typedef struct {
    pose_sample needles[TROCAR_MAX_NEEDLES];
} newest_poses;

/* One needle's part of a view_sample */
typedef struct {
    bool engaged;                /* a hand has held the needle since the server started */
    int64_t pose_utime;          /* us, utime of the pose that this tick responded to */
    int flags;                   /* flags as in needle_wrench_t */
    int64_t saturated_ticks;     /* since start */
    double energy, energy_lowest; /* J, net energy that the hand has put into the coupling since engaging, and the minimum of it so far */
    double coupling_stiffness;   /* N/m; 0 if the coupling is rigid */
    int contacts;
    int state;                   /* state as in status_t */
} needle_view;

/* From the haptic thread to the telemetry thread, about 60 times per second: the last tick's results, for viewers */
typedef struct {
    int64_t tick;
    int64_t wrench_dropped;      /* since start */
    double snapshot_age;         /* s, age of the oldest unanswered request; 0 if there is none */
    needle_view needles[TROCAR_MAX_NEEDLES];
    trocar_picture *picture;     /* owned by this slot of the triple buffer; NULL if there is no model */
} view_sample;

/* Creates a triple buffer of views, each with a picture of this model. With a NULL model, as in some tests, the views have no pictures. */
trocar_status views_create(triple_buffer *views, trocar_model *model, trocar_error *why);
void views_free(triple_buffer *views);

/* From the worker to the telemetry thread: what has gone wrong in the worker */
typedef struct {
    bool lasts;                  /* no request has been answered since */
    trocar_error why;
} worker_fault;

/* Copies a view's contents. `from` and `to` keep their own picture buffers. */
void view_copy(const view_sample *from, view_sample *to);

/* From the IO thread to the relay thread: a message for the client with this session */
typedef struct {
    int64_t session;
    const char *channel;
    size_t size;
    unsigned char bytes[1024];
} outgoing_message;

typedef struct {
    triple_buffer poses;          /* newest_poses */
    triple_buffer probe_poses;    /* probe_sample */
    triple_buffer views;          /* view_sample */
    triple_buffer loops;          /* loop_record */
    triple_buffer intakes;        /* arbiter_record */
    triple_buffer faults;         /* worker_fault */
    spsc_ring wrenches;          /* trocar_needle_wrench_t */
    spsc_ring probe_wrenches;    /* trocar_probe_wrench_t */
    spsc_ring commands, replies; /* needle_command */
    spsc_ring latencies;         /* int64_t, ns: how long the worker took to answer each request */
    spsc_ring round_trips;       /* int64_t, ns: from computing a wrench until the first pose that responds to it arrived */
    spsc_ring outgoing;          /* outgoing_message; not allocated without a relay thread */
    atomic_bool probe_stopped;   /* from haptic to IO thread: the tissue has stopped the probe short of its newest pose */
    int io_wake, worker_wake;    /* non-blocking eventfds; a write to worker_wake stops the worker */
    int relay_wake;              /* eventfd that wakes the relay thread; -1 if there is none */
} exchange;

/* Creates all buffers. `model` as in views_create. */
trocar_status exchange_create(exchange *x, trocar_model *model, trocar_error *why);
void exchange_free(exchange *x);

/* Creates the buffer from the IO thread to the relay thread. */
trocar_status exchange_add_relay(exchange *x, trocar_error *why);

#endif
