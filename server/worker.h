/* The background thread that serves the simulation's requests. */
#ifndef TROCAR_WORKER_H
#define TROCAR_WORKER_H

#include "exchange.h"

typedef struct {
    exchange *exchange;
    trocar_sim *sim;
    atomic_bool stop;
    bool faulty;             /* a request has failed since the last one that succeeded; from here on, used only by the thread */
    int64_t served, failed;  /* requests answered, and requests failed; valid once the thread has ended */
    trocar_error first;      /* reason for the first failure */
} worker;

/* Main function of the thread. `context` is a worker. Uses trocar_sim_work to serve the newest request, and prefetches data for later ones when idle. */
void *worker_run(void *context);

/* Ends the thread once it has finished its current request. */
void worker_stop(worker *w);

#endif
