/* The background thread that serves the simulation's requests. */
#ifndef TROCAR_WORKER_H
#define TROCAR_WORKER_H

#include "exchange.h"

typedef struct {
    exchange *exchange;
    trocar_sim *sim;
    atomic_bool stop;
    bool faulty;             /* a request has failed since the last successful one; this and all following members are used only by the thread */
    int64_t served, failed;  /* number of requests that were answered, and that failed; valid after the thread has ended */
    trocar_error first;      /* reason for the first failure */
} worker;

/* Main function of the thread; `context` is a worker. Serves only the newest request, with trocar_sim_work. While idle, it prefetches data for later
   requests. */
void *worker_run(void *context);

/* Ends the thread after it has finished its current request. */
void worker_stop(worker *w);

#endif
