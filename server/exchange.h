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

   With --listen, the IO thread also passes its messages to the relay thread, which has its own LCM connection to publish its clients' messages.

   Newest values are passed in triple buffers, queues in rings with one writer and one reader: see base/triple_buffer.h and base/spsc_ring.h. */
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

/* State of one needle in a view_sample */
typedef struct {
    bool engaged;                /* true if a hand has held the needle at any time since the server started */
    int64_t pose_utime;          /* us, utime of the pose to which this tick responded */
    int flags;                   /* flags as in needle_wrench_t */
    int64_t saturated_ticks;     /* since start */
    double energy, energy_lowest; /* J, net energy that the hand has put into the coupling since the engagement, and its minimum so far */
    double coupling_stiffness;   /* N/m; 0 if the coupling is rigid */
    int contacts;
    int state;                   /* state as in status_t */
} needle_view;

/* From the haptic thread to the telemetry thread, about 60 times per second: results of the last tick for viewers */
typedef struct {
    int64_t tick;
    int64_t wrench_dropped;      /* since start */
    double snapshot_age;         /* s, age of the oldest unanswered request; 0 if all requests have been answered */
    needle_view needles[TROCAR_MAX_NEEDLES];
    trocar_picture *picture;     /* belongs to this slot of the triple buffer; NULL if there is no model */
} view_sample;

/* Creates a triple buffer of views, each with a picture of this model. If `model` is NULL, as in some tests, the views have no pictures. */
trocar_status views_create(triple_buffer *views, trocar_model *model, trocar_error *why);
void views_free(triple_buffer *views);

/* From the worker to the telemetry thread: the worker's fault */
typedef struct {
    bool lasts;                  /* the worker has not answered any request since the fault */
    trocar_error why;
} worker_fault;

/* Copies the contents of a view. `from` and `to` each keep their own picture buffer. */
void view_copy(const view_sample *from, view_sample *to);

/* From the IO thread to the relay thread: a message to the client with this session */
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
    spsc_ring latencies;         /* int64_t, ns: times between a request and the worker's answer */
    spsc_ring round_trips;       /* int64_t, ns: times between computing a wrench and the arrival of the first pose that refers to it */
    spsc_ring outgoing;          /* outgoing_message; not allocated if there is no relay thread */
    atomic_bool probe_stopped;   /* from haptic to IO thread: the tissue stops the probe before it reaches its newest pose */
    int io_wake, worker_wake;    /* non-blocking eventfds; a write to worker_wake stops the worker */
    int relay_wake;              /* eventfd that wakes the relay thread; -1 if there is none */
} exchange;

/* Creates all buffers; `model` has the same meaning as in views_create. */
trocar_status exchange_create(exchange *x, trocar_model *model, trocar_error *why);
void exchange_free(exchange *x);

/* Creates the buffer between the IO thread and the relay thread. */
trocar_status exchange_add_relay(exchange *x, trocar_error *why);

#endif
