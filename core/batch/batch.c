#define _GNU_SOURCE /* sched_getaffinity */
#include "batch/batch.h"

#include <sched.h>
#include <stdlib.h>
#include <unistd.h>

#include "base/cache_line.h"
#include "base/host_log.h"
#include "tissue/blas.h"

/* ---- loops over rows ------------------------------------------------------------------------------------------------------------- */

typedef struct {
    trocar_batch *batch;
    row_task task;
    void *context;
} row_loop;

static void run_row(void *context, int i, int member) {
    row_loop *loop = context;
    trocar_batch *batch = loop->batch;
    int row = batch->listed[i];
    trocar_sim *sim = batch->rows[row].sim;
    trocar_error why;
    if (sim) {
        sim->workspace = batch->workspaces[member];
        sim->workspace->profile.clock = sim->clock;
    }
    trocar_status status = loop->task(batch, row, member, loop->context, &why);
    if (status != TROCAR_OK) first_failure_note(&batch->failure, row, status, &why);
}

void batch_for_rows(trocar_batch *batch, const uint8_t *mask, row_task task, void *context) {
    row_loop loop = {batch, task, context};
    int count = 0;
    for (int row = 0; row < batch->row_count; row++)
        if (batch_has(mask, row)) batch->listed[count++] = row;
    if (batch->process != getpid()) { /* fork() does not copy threads, so a child process needs a new team; the old one's memory is not freed */
        batch->process = getpid();
        batch->team = team_create(batch->threads);
    }
    team_run(batch->team, count, run_row, &loop);
}

void batch_begin(trocar_batch *batch) { first_failure_clear(&batch->failure); }

trocar_status batch_end(const trocar_batch *batch, trocar_error *why) {
    const first_failure *f = &batch->failure;
    return f->status == TROCAR_OK ? TROCAR_OK : fail(why, f->status, "row %d: %.1000s", f->index, f->why.text);
}

/* ---- creation -------------------------------------------------------------------------------------------------------------------- */

trocar_batch_options trocar_default_batch_options(void) { return (trocar_batch_options){.needles = 1}; }

static int usable_processors(void) {
    cpu_set_t set;
    int count = sched_getaffinity(0, sizeof set, &set) == 0 ? CPU_COUNT(&set) : 1;
    return count < 1 ? 1 : count > MAX_THREADS ? MAX_THREADS : count;
}

/* Replaces a row's simulation. On failure, the row is unchanged. */
static trocar_status create_row(batch_row *row, trocar_model *model, insertion_workspace *workspace, trocar_error *why) {
    batch_row created;
    trocar_status status = row_create(model, workspace, &created, why);
    if (status != TROCAR_OK) return status;
    row_free(row);
    *row = created;
    return TROCAR_OK;
}

static trocar_status create_task(trocar_batch *batch, int row, int member, void *context, trocar_error *why) {
    trocar_model *const *models = context;
    return create_row(&batch->rows[row], models[row], batch->workspaces[member], why);
}

static trocar_status check_options(trocar_model *const *models, int rows, const trocar_batch_options *o, trocar_error *why) {
    if (rows < 1 || o->threads < 0 || o->threads > MAX_THREADS || o->needles < 1 || o->needles > MAX_NEEDLES)
        return fail(why, TROCAR_BAD_INPUT, "a batch of %d rows with %d needles in %d threads: at least 1 row, 1 to %d needles, 0 to %d threads", rows, o->needles,
                    o->threads, MAX_NEEDLES, MAX_THREADS);
    for (int i = 0; i < rows; i++) {
        trocar_error wrong;
        trocar_status status = check_driven_needles(models[i], o->needles, &wrong);
        if (status != TROCAR_OK) return fail(why, status, "row %d: %.1000s", i, wrong.text);
    }
    return TROCAR_OK;
}

/* Starts `wanted` threads, or as many as the system and its memory allow, and allocates their workspaces. */
static trocar_status start_threads(trocar_batch *batch, int wanted, trocar_error *why) {
    trocar_error ignored;
    while (wanted > 1 && blas_make_room(wanted, &ignored) != TROCAR_OK) wanted--;
    batch->team = team_create(wanted);
    batch->process = getpid();
    batch->threads = team_members(batch->team);
    batch->workspaces = calloc((size_t)batch->threads, sizeof *batch->workspaces);
    for (int i = 0; batch->workspaces && i < batch->threads; i++) {
        batch->workspaces[i] = allocate_on_cache_lines(sizeof **batch->workspaces);
        if (!batch->workspaces[i]) return fail(why, TROCAR_NO_MEMORY, "no memory for the threads of a batch");
    }
    return batch->workspaces ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for the threads of a batch");
}

trocar_status trocar_batch_create(trocar_model *const *models, int rows, const trocar_batch_options *given, trocar_batch **created, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_batch_options options = given ? *given : trocar_default_batch_options();
    *created = NULL;
    trocar_status status = check_options(models, rows, &options, why);
    if (status != TROCAR_OK) return status;
    trocar_batch *batch = calloc(1, sizeof *batch);
    if (!batch) return fail(why, TROCAR_NO_MEMORY, "no memory for a batch");
    batch->row_count = rows;
    batch->needles = options.needles;
    first_failure_create(&batch->failure);
    batch->rows = calloc((size_t)rows, sizeof *batch->rows);
    batch->listed = calloc((size_t)rows, sizeof *batch->listed);
    batch->done = calloc((size_t)rows, sizeof *batch->done);
    batch->row_failed = calloc((size_t)rows, sizeof *batch->row_failed);
    bool allocated = batch->rows && batch->listed && batch->done && batch->row_failed;
    int wanted = options.threads > 0 ? options.threads : usable_processors();
    if (wanted > rows) wanted = rows;
    status = allocated ? start_threads(batch, wanted, why) : fail(why, TROCAR_NO_MEMORY, "no memory for a batch of %d rows", rows);
    if (status == TROCAR_OK && batch->threads < wanted)
        host_log(&models[0]->log, TROCAR_LOG_WARNING, "the batch has %d of %d threads: no memory for more", batch->threads, wanted);
    if (status == TROCAR_OK) {
        batch_begin(batch);
        batch_for_rows(batch, NULL, create_task, (void *)models);
        status = batch_end(batch, why);
    }
    if (status == TROCAR_OK) *created = batch;
    else trocar_batch_free(batch);
    return status;
}

void trocar_batch_free(trocar_batch *batch) {
    if (!batch) return;
    if (batch->process == getpid()) team_free(batch->team);
    for (int i = 0; batch->rows && i < batch->row_count; i++) row_free(&batch->rows[i]);
    for (int i = 0; batch->workspaces && i < batch->threads; i++) free(batch->workspaces[i]);
    first_failure_free(&batch->failure);
    free(batch->workspaces);
    free(batch->rows);
    free(batch->listed);
    free(batch->done);
    free(batch->row_failed);
    free(batch);
}

int trocar_batch_rows(const trocar_batch *batch) { return batch->row_count; }
int trocar_batch_needles(const trocar_batch *batch) { return batch->needles; }
int trocar_batch_threads(const trocar_batch *batch) { return batch->threads; }

static bool has_row(const trocar_batch *batch, int row) { return row >= 0 && row < batch->row_count; }

trocar_sim *trocar_batch_sim(trocar_batch *batch, int row) { return has_row(batch, row) ? batch->rows[row].sim : NULL; }

trocar_status trocar_batch_set_model(trocar_batch *batch, int row, trocar_model *model, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (!has_row(batch, row)) return fail(why, TROCAR_BAD_INPUT, "row %d: the batch has %d, numbers 0 to %d", row, batch->row_count, batch->row_count - 1);
    trocar_status status = check_driven_needles(model, batch->needles, why);
    return status == TROCAR_OK ? create_row(&batch->rows[row], model, batch->workspaces[0], why) : status;
}

/* ---- starting and continuing ----------------------------------------------------------------------------------------------------- */

static trocar_status reset_task(trocar_batch *batch, int row, int member, void *context, trocar_error *why) {
    (void)member;
    return row_reset(&batch->rows[row], batch->needles, (const trocar_pose *)context + (size_t)row * (size_t)batch->needles, why);
}

trocar_status trocar_batch_reset(trocar_batch *batch, const trocar_pose *poses, const uint8_t *mask, trocar_error *error) {
    trocar_error ignored;
    batch_begin(batch);
    batch_for_rows(batch, mask, reset_task, (void *)poses);
    return batch_end(batch, error ? error : &ignored);
}

typedef struct {
    void *const *states;
    size_t size;
} save_call;

static trocar_status save_task(trocar_batch *batch, int row, int member, void *context, trocar_error *why) {
    (void)member;
    const save_call *call = context;
    return trocar_sim_save(batch->rows[row].sim, call->states[row], call->size, why);
}

trocar_status trocar_batch_save(trocar_batch *batch, void *const *states, size_t size, const uint8_t *mask, trocar_error *error) {
    trocar_error ignored;
    batch_begin(batch);
    batch_for_rows(batch, mask, save_task, &(save_call){states, size});
    return batch_end(batch, error ? error : &ignored);
}

typedef struct {
    const void *const *states;
    const size_t *sizes;
} restore_call;

static trocar_status restore_task(trocar_batch *batch, int row, int member, void *context, trocar_error *why) {
    (void)member;
    const restore_call *call = context;
    return trocar_sim_restore(batch->rows[row].sim, call->states[row], call->sizes[row], why);
}

trocar_status trocar_batch_restore(trocar_batch *batch, const void *const *states, const size_t *sizes, const uint8_t *mask, trocar_error *error) {
    trocar_error ignored;
    batch_begin(batch);
    batch_for_rows(batch, mask, restore_task, &(restore_call){states, sizes});
    return batch_end(batch, error ? error : &ignored);
}
