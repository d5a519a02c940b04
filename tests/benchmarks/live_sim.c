#include "live_sim.h"

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "common/realtime.h"

void must(trocar_status status, const char *what, const trocar_error *why) {
    if (status == TROCAR_OK) return;
    fprintf(stderr, "%s: %s\n", what, why->text);
    exit(1);
}

void live_worker_start(live_worker *w, trocar_sim *sim) {
    trocar_error why;
    must(exchange_create(&w->exchange, NULL, &why), "worker", &why);
    w->awake = realtime_stay_awake(&why);
    w->worker = (worker){.exchange = &w->exchange, .sim = sim};
    if (pthread_create(&w->thread, NULL, worker_run, &w->worker) != 0) must(fail(&why, TROCAR_SYSTEM, "cannot create a thread"), "worker", &why);
}

void live_worker_stop(live_worker *w, histogram *latency) {
    int64_t nanoseconds;
    worker_stop(&w->worker);
    pthread_join(w->thread, NULL);
    while (spsc_ring_pop(&w->exchange.latencies, &nanoseconds)) histogram_add(latency, nanoseconds);
    if (w->worker.failed > 0) fprintf(stderr, "worker: %s\n", w->worker.first.text);
    exchange_free(&w->exchange);
    if (w->awake >= 0) close(w->awake);
}

void print_times(const histogram *times, double unit, int width, int digits) {
    const double values[] = {histogram_quantile(times, 0.5), histogram_quantile(times, 0.99), histogram_max(times)};
    for (int i = 0; i < 3; i++) printf(" %*.*f", width, digits, unit * values[i]);
}
