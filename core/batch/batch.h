/* The struct behind the handle of trocar/batch.h, and loops over its rows. */
#ifndef TROCAR_BATCH_H
#define TROCAR_BATCH_H

#include <pthread.h>
#include <sys/types.h>

#include "api/api.h"
#include "base/team.h"

/* A row: its simulation, and the state to which a reset returns. */
typedef struct {
    trocar_sim *sim;
    void *fresh;             /* state saved after the creation of `sim` */
    size_t fresh_bytes;
} batch_row;

struct trocar_batch {
    int row_count, needles, threads;
    batch_row *rows;
    team *team;              /* NULL for a single thread */
    pid_t process;           /* process that started the team's threads: after a fork, the child has none of them */
    insertion_workspace **workspaces; /* one for each thread */
    int *listed;             /* scratch: the rows of a call */
    int *done;               /* scratch: steps that each row has completed in a call */
    bool *row_failed;        /* scratch: rows that have failed in a call */
    pthread_mutex_t lock;    /* protects the members below during a call */
    int failed;              /* first row that failed; row_count if none has */
    trocar_status status;    /* its status and message */
    report why;
};

/* What a call does with one row. `member`: number of the thread; 0 is the calling thread. */
typedef trocar_status (*row_task)(trocar_batch *batch, int row, int member, void *context, report *why);

/* Calls `task` for each row of the mask (NULL: all rows), shared among the threads; the row's simulation uses the workspace of the thread. */
void batch_for_rows(trocar_batch *batch, const uint8_t *mask, row_task task, void *context);

/* batch_end: returns the error of the first row that has failed since batch_begin. */
void batch_begin(trocar_batch *batch);
trocar_status batch_end(const trocar_batch *batch, report *why);

static inline bool batch_has(const uint8_t *mask, int row) { return !mask || mask[row]; }

#endif
