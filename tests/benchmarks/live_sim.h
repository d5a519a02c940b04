/* A simulation that runs in real time, with the server's worker in a second thread. */
#ifndef TROCAR_LIVE_SIM_H
#define TROCAR_LIVE_SIM_H

#include <pthread.h>

#include "common/timing.h"
#include "worker.h"

typedef struct {
    exchange exchange;
    worker worker;
    pthread_t thread;
    int awake;               /* descriptor that keeps the processors awake, as a server does, or -1 */
} live_worker;

/* Prints the error message and exits if the call failed. */
void must(trocar_status status, const char *what, const trocar_error *why);

/* Starts the worker thread. */
void live_worker_start(live_worker *w, trocar_sim *sim);

/* Stops the worker thread, adds the times from request to answer to the histogram, and reports the first failed request. */
void live_worker_stop(live_worker *w, histogram *latency);

/* Prints median, 99th percentile and maximum, multiplied by `unit`, in columns of this width. */
void print_times(const histogram *times, double unit, int width, int digits);

#endif
