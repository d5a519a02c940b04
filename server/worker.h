/* The background thread that serves the simulation's requests. */
#ifndef TROCAR_WORKER_H
#define TROCAR_WORKER_H

#include "exchange.h"

typedef struct {
    exchange *exchange;
    trocar_sim *sim;
    atomic_bool stop;
    bool faulty;             /* a request has failed since the last answered one; from here on used by the thread only */
    int64_t served, failed;  /* number of requests answered and failed, valid after the thread has ended */
    report first;            /* reason of the first failure */
} worker;

/* Body of the thread; `context` is a worker. Serves only the newest request, by trocar_sim_work. While it is idle, it prepares nodes in advance. */
void *worker_run(void *context);

/* Ends the thread after it has finished its current request. */
void worker_stop(worker *w);

#endif
