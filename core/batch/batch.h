/* The struct behind the handle of trocar/batch.h, and loops over its rows. */
#ifndef TROCAR_BATCH_H
#define TROCAR_BATCH_H

#include <sys/types.h>

#include "api/api.h"
#include "base/team.h"
#include "batch/first_failure.h"
#include "batch/row.h"

struct trocar_batch {
    int row_count, needles, threads;
    batch_row *rows;
    team *team;              /* NULL if there is a single thread */
    pid_t process;           /* process in which the team's threads run; a child process does not inherit them after fork() */
    insertion_workspace **workspaces; /* one for each thread */
    int *listed;             /* scratch: indices of the rows that a call applies to */
    int *done;               /* scratch: for each row, number of steps completed in a call */
    bool *row_failed;        /* scratch: for each row, true if it has failed in a call */
    first_failure failure;   /* the failure that a call will report */
};

/* A function that processes one row. `member`: index of the thread; 0 is the calling thread. */
typedef trocar_status (*row_task)(trocar_batch *batch, int row, int member, void *context, trocar_error *why);

/* Calls `task` for each row of the mask (NULL: all rows); the rows are distributed among the threads. During the task, the row's simulation uses the workspace
   of the thread that runs it. */
void batch_for_rows(trocar_batch *batch, const uint8_t *mask, row_task task, void *context);

/* batch_begin clears the error. batch_end returns the error that has occurred since; if several rows have failed, that of the row with the lowest index. */
void batch_begin(trocar_batch *batch);
trocar_status batch_end(const trocar_batch *batch, trocar_error *why);

static inline bool batch_has(const uint8_t *mask, int row) { return !mask || mask[row]; }

#endif
