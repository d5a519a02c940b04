#include "worker.h"

#include "realtime.h"
#include "timing.h"

trocar_status worker_remesh(void *remesher, const remesh_request *request, compliance_snapshot *snapshot, report *why) {
    return remesher_serve(remesher, request, snapshot, why);
}

bool worker_look_ahead(void *remesher) { return remesher_look_ahead(remesher); }

static void note_failure(worker *w, const report *why) {
    if (atomic_load_explicit(&w->failed, memory_order_relaxed)) return;
    w->why = *why;
    atomic_store_explicit(&w->failed, true, memory_order_release);
}

/* A request that fails leaves the last snapshot in force: the tick goes on with it and flags that it is late. */
static void serve(worker *w, const request_sample *sample) {
    report why;
    trocar_status status = w->serve(w->context, &sample->request, triple_buffer_slot(&w->exchange->snapshots), &why);
    if (status != TROCAR_OK) {
        note_failure(w, &why);
        return;
    }
    triple_buffer_publish(&w->exchange->snapshots);
    int64_t latency = monotonic_ns() - sample->requested;
    spsc_ring_push(&w->exchange->latencies, &latency);
    w->served++;
}

void *worker_run(void *context) {
    worker *w = context;
    realtime_flush_denormals();
    for (;;) {
        wait_for_wake(w->exchange->worker_wake);
        if (atomic_load_explicit(&w->stop, memory_order_acquire)) return NULL;
        bool fresh;
        const request_sample *sample = triple_buffer_read(&w->exchange->requests, &fresh);
        if (fresh) serve(w, sample);
        while (w->look_ahead && !wake_pending(w->exchange->worker_wake) && w->look_ahead(w->context)) continue;
    }
}

void worker_stop(worker *w) {
    atomic_store_explicit(&w->stop, true, memory_order_release);
    wake(w->exchange->worker_wake);
}
