#include "worker.h"

#include <errno.h>
#include <poll.h>

#include "realtime.h"

static void note_failure(worker *w, const report *why) {
    if (atomic_load_explicit(&w->failed, memory_order_relaxed)) return;
    w->why = *why;
    atomic_store_explicit(&w->failed, true, memory_order_release);
}

/* Serves one request, or runs one slice of looking ahead. Returns whether there is more to do. After a failed request the tick
   keeps using the last answer and sets the flag that it is late. */
static bool work(worker *w) {
    report why;
    trocar_work done = {.more = 0};
    if (trocar_sim_work(w->sim, &done, &why) != TROCAR_OK && !done.kept) note_failure(w, &why); /* the client is told of a needle that was kept */
    if (done.answered) {
        spsc_ring_push(&w->exchange->latencies, &done.latency);
        w->served++;
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
    wake(w->exchange->worker_wake);
}
