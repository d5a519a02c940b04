/* All that the server's threads share:

                    poses                       requests
     IO thread  ------------->  haptic thread  ---------->  worker
     (LCM)      <-------------  (the tick)     <----------
                  wrenches          |            snapshots     |
        | intakes                   | views, loops,            | latencies
        |                           | round_trips              |
        +------------------->  telemetry thread  <-------------+
                                  (own LCM)
                                    | views
                               pictures thread

   Newest values are triple buffers, queues are rings of one writer and one reader: see base/triple_buffer.h and base/spsc_ring.h. */
#ifndef TROCAR_EXCHANGE_H
#define TROCAR_EXCHANGE_H

#include "base/spsc_ring.h"
#include "base/triple_buffer.h"
#include "insertion/insertion.h"

/* haptic -> worker */
typedef struct {
    int64_t requested;           /* ns, monotonic */
    remesh_request request;
} request_sample;

/* haptic -> telemetry, about 60 Hz: what a viewer may see of the last tick */
typedef struct {
    int64_t tick;
    int64_t pose_utime;          /* us, of the pose that the tick answers */
    int flags;                   /* as in needle_wrench_t */
    int64_t wrench_dropped, saturated_ticks; /* since start */
    double energy, energy_lowest; /* J, from the hand into the coupling */
    double coupling_stiffness;   /* N/m, 0: rigid */
    double snapshot_age;         /* s since the oldest request that is not answered yet, 0 if all are */
    insertion_state state;
} view_sample;

typedef struct {
    triple_buffer poses;          /* pose_sample */
    triple_buffer requests;       /* request_sample */
    triple_buffer snapshots;      /* compliance_snapshot */
    triple_buffer views;          /* view_sample */
    triple_buffer loops;          /* loop_record */
    triple_buffer intakes;        /* arbiter_record */
    spsc_ring wrenches;          /* trocar_needle_wrench_t */
    spsc_ring latencies;         /* int64_t: request to snapshot, ns */
    spsc_ring round_trips;       /* int64_t: wrench computed to the arrival of a pose that names it, ns */
    int io_wake, worker_wake;    /* eventfds; neither read nor write ever blocks */
} exchange;

trocar_status exchange_create(exchange *x, report *why);
void exchange_free(exchange *x);

void wake(int eventfd);          /* RT */
bool wake_pending(int eventfd);  /* wait_for_wake would return at once */
void wait_for_wake(int eventfd); /* blocks until the next wake, or returns at once if there was one */

#endif
