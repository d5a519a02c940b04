/* The background thread that serves the simulation's requests. */
#ifndef TROCAR_WORKER_H
#define TROCAR_WORKER_H

#include "exchange.h"

typedef struct {
    exchange *exchange;
    trocar_sim *sim;
    atomic_bool stop;
    bool faulty;             /* it has failed since the last request that it answered; from here on used by the thread only, */
    int64_t served, failed;  /* number of requests and of failures, valid after the thread has ended, */
    report first;            /* and the reason of the first failure */
} worker;

/* Body of the thread; `context` is a worker. Serves only the newest request, by trocar_sim_work; when idle, it prepares nodes ahead. */
void *worker_run(void *context);

/* Ends the thread after its current request. */
void worker_stop(worker *w);

#endif
