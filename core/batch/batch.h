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
    pid_t process;           /* process that the team's threads run in; a child does not inherit them across fork() */
    insertion_workspace **workspaces; /* one per thread */
    int *listed;             /* scratch: indices of the rows that the current call applies to */
    int *done;               /* scratch: for each row, number of steps completed in the current call */
    bool *row_failed;        /* scratch: for each row, true if it has failed in the current call */
    first_failure failure;   /* the failure that the current call will report */
};

/* A function that processes one row. `member`: index of the thread; 0 is the calling thread. */
typedef trocar_status (*row_task)(trocar_batch *batch, int row, int member, void *context, trocar_error *why);

/* Calls `task` for each masked row (NULL: all rows), distributing the rows among the threads. During the task, the row's simulation uses the workspace of the
   thread that runs it. */
void batch_for_rows(trocar_batch *batch, const uint8_t *mask, row_task task, void *context);

/* batch_begin clears the recorded failure. batch_end returns the error recorded since then; if several rows failed, that of the lowest-numbered row. */
void batch_begin(trocar_batch *batch);
trocar_status batch_end(const trocar_batch *batch, trocar_error *why);

static inline bool batch_has(const uint8_t *mask, int row) { return !mask || mask[row]; }

#endif
