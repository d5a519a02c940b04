/* The background thread that serves the simulation's requests. */
#ifndef TROCAR_WORKER_H
#define TROCAR_WORKER_H

#include "exchange.h"

typedef struct {
    exchange *exchange;
    trocar_sim *sim;
    atomic_bool stop;
    atomic_bool failed;      /* a request failed; `why` then holds the first reason and does not change */
    report why;
    int64_t served;          /* valid after the thread has ended */
} worker;

/* Body of the thread; `context` is a worker. Only the newest request is served, as by trocar_sim_work; idle time is used for
   looking ahead. */
void *worker_run(void *context);

/* Ends the thread after its current request. */
void worker_stop(worker *w);

#endif
