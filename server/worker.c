#include "worker.h"

#include <errno.h>
#include <poll.h>

#include "common/realtime.h"
#include "common/eventfd_signal.h"

/* Publishes what has gone wrong in the worker. `why` is NULL once it works again. */
static void show_fault(worker *w, const trocar_error *why) {
    worker_fault *fault = triple_buffer_slot(&w->exchange->faults);
    fault->lasts = w->faulty = why != NULL;
    if (why) fault->why = *why;
    triple_buffer_publish(&w->exchange->faults);
}

static void note_failure(worker *w, const trocar_error *why) {
    if (w->failed++ == 0) w->first = *why;
    show_fault(w, why);
}

/* Serves one request, or does one slice of work that can be done in advance. Returns true if there is more to do. After a failed request, the tick keeps using
   the last answer and flags it as late. The fault lasts until a request is answered. */
static bool work(worker *w) {
    trocar_error why;
    trocar_work done = {.more = 0};
    if (trocar_sim_work(w->sim, &done, &why) != TROCAR_OK && !done.still_held) note_failure(w, &why); /* if a needle could not be left and is still held, the
                                                                                                         reply to the client reports this, so it is not a fault
                                                                                                         of the worker */
    if (done.answered) {
        spsc_ring_push(&w->exchange->latencies, &done.latency);
        w->served++;
        if (w->faulty) show_fault(w, NULL);
    }
    return done.more;
}

static void wait_for_request(const worker *w) {
    struct pollfd either[] = {{.fd = trocar_sim_work_descriptor(w->sim), .events = POLLIN},
                              {.fd = w->exchange->worker_wake, .events = POLLIN}};
    while (poll(either, 2, -1) < 0 && errno == EINTR) continue;
}

static bool stopped(const worker *w) { return atomic_load_explicit(&w->stop, memory_order_acquire); }

void *worker_run(void *context) {
    worker *w = context;
    realtime_flush_denormals();
    while (!stopped(w)) {
        wait_for_request(w);
        while (!stopped(w) && work(w)) continue;
    }
    return NULL;
}

void worker_stop(worker *w) {
    atomic_store_explicit(&w->stop, true, memory_order_release);
    eventfd_signal(w->exchange->worker_wake);
}
