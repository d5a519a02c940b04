/* The background thread that serves the simulation's requests. */
#ifndef TROCAR_WORKER_H
#define TROCAR_WORKER_H

#include "exchange.h"

typedef struct {
    exchange *exchange;
    trocar_sim *sim;
    atomic_bool stop;
    bool faulty;             /* it has failed since the last request that it answered; from here on used by the thread only, */
    int64_t served, failed;  /* and valid after it has ended: requests, failures, */
    report first;            /* and the first one's reason */
} worker;

/* Body of the thread; `context` is a worker. Only the newest request is served, as by trocar_sim_work; idle time is used for
   looking ahead. */
void *worker_run(void *context);

/* Ends the thread after its current request. */
void worker_stop(worker *w);

#endif
