/* The background thread that brings the refined mesh to what the tick wants next. */
#ifndef TROCAR_WORKER_H
#define TROCAR_WORKER_H

#include "exchange.h"

/* Fills the snapshot for a request; may take as long as it likes. */
typedef trocar_status (*worker_serve)(void *context, const remesh_request *request, compliance_snapshot *snapshot,
                                      report *why);

typedef struct {
    exchange *exchange;
    worker_serve serve;
    bool (*look_ahead)(void *context); /* a slice of work for idle time, false: nothing left; NULL: none */
    void *context;
    atomic_bool stop;
    atomic_bool failed;      /* a request could not be served; `why` then holds the first reason for good */
    report why;
    int64_t served;          /* to be read after the thread has ended */
} worker;

/* `serve` with a remesher as context. */
trocar_status worker_remesh(void *remesher, const remesh_request *request, compliance_snapshot *snapshot, report *why);

bool worker_look_ahead(void *remesher);

/* Body of the thread; `context` is a worker. Only the newest request is served; older ones are forgotten. */
void *worker_run(void *context);

/* Ends the thread after the request that it is serving. */
void worker_stop(worker *w);

#endif
