/* The background thread that keeps the simulation's answers up with its ticks. */
#ifndef TROCAR_WORKER_H
#define TROCAR_WORKER_H

#include "exchange.h"

typedef struct {
    exchange *exchange;
    trocar_sim *sim;
    atomic_bool stop;
    atomic_bool failed;      /* a request could not be served; `why` then holds the first reason for good */
    report why;
    int64_t served;          /* to be read after the thread has ended */
} worker;

/* Body of the thread; `context` is a worker. Only the newest request is served, as trocar_sim_work does; idle time goes into
   looking ahead. */
void *worker_run(void *context);

/* Ends the thread after the request that it is serving. */
void worker_stop(worker *w);

#endif
