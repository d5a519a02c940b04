/* Implements trocar/rollout.h. Distributes many insertions among threads; each thread runs one insertion at a time. */
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "api/api.h"
#include "base/host_log.h"
#include "base/host_watch.h"
#include "base/team.h"
#include "batch/first_failure.h"
#include "batch/row.h"
#include "tissue/blas.h"

/* The simulation of one thread. */
typedef struct {
    trocar_model *model;     /* model of the simulation in `row`; NULL if there is no simulation */
    batch_row row;
} seat;

typedef struct {
    const trocar_rollout_options *options;
    trocar_model *model;     /* used for all insertions if options->models is NULL */
    const trocar_pose *poses;
    int batch, steps;
    trocar_output *outputs;
    int seat_count;          /* number of threads, including the calling one */
    seat seats[MAX_THREADS];
    atomic_bool cancelled;
    atomic_llong ticks;      /* number of steps completed over all insertions */
    first_failure failure;
} rollout;

static trocar_model *model_of(const rollout *r, int insertion) { return r->options->models ? r->options->models[insertion] : r->model; }

/* ---- simulations ----------------------------------------------------------------------------------------------------------------- */

/* Gives the seat a simulation of this model, unless it already has one. */
static trocar_status seat_model(seat *s, trocar_model *model, trocar_error *why) {
    if (s->model == model) return TROCAR_OK;
    row_free(&s->row);
    trocar_status status = row_create(model, NULL, &s->row, why);
    s->model = status == TROCAR_OK ? model : NULL;
    return status;
}

/* Allocates simulations for `wanted` threads, or for as many as fit in memory. Fails if not even one fits. */
static trocar_status take_seats(rollout *r, int wanted, trocar_error *why) {
    trocar_error ignored;
    trocar_status status = TROCAR_OK;
    while (wanted > 1 && blas_make_room(wanted, &ignored) != TROCAR_OK) wanted--;
    while (r->seat_count < wanted && status == TROCAR_OK) {
        status = seat_model(&r->seats[r->seat_count], model_of(r, 0), r->seat_count == 0 ? why : &ignored);
        r->seat_count += status == TROCAR_OK;
    }
    return r->seat_count > 0 ? TROCAR_OK : status;
}

/* ---- one insertion --------------------------------------------------------------------------------------------------------------- */

/* Restores the saved state given for the insertion. If there is none, restores the simulation's state at creation and places the needles at their first
   poses. Either way, results do not depend on what the thread ran before. */
static trocar_status begin(const rollout *r, seat *s, int insertion, const trocar_pose *first, trocar_error *why) {
    trocar_status status = seat_model(s, model_of(r, insertion), why);
    if (status != TROCAR_OK) return status;
    const trocar_rollout_options *o = r->options;
    if (o->states && o->states[insertion]) return trocar_sim_restore(s->row.sim, o->states[insertion], o->state_sizes[insertion], why);
    return row_reset(&s->row, o->needles, first, why);
}

/* Reports progress and checks for cancellation. Called only in the thread that called trocar_rollout (member 0). */
static void look(void *context) {
    rollout *r = context;
    watch_report(&r->options->watch, "rollout", (double)atomic_load(&r->ticks) / ((double)r->batch * r->steps));
    if (watch_cancels(&r->options->watch)) atomic_store(&r->cancelled, true);
}

static void run_insertion(void *context, int insertion, int member) {
    rollout *r = context;
    seat *s = &r->seats[member];
    int needles = r->options->needles, done = 0;
    size_t first = (size_t)insertion * (size_t)r->steps * (size_t)needles;
    trocar_error reason, why;
    if (atomic_load(&r->cancelled)) return;
    trocar_status status = begin(r, s, insertion, r->poses + first, &reason);
    while (done < r->steps && status == TROCAR_OK && !atomic_load(&r->cancelled)) {
        int before = done, end = watch_next_look(done, r->steps);
        for (; done < end && status == TROCAR_OK; done += status == TROCAR_OK) {
            size_t at = first + (size_t)done * (size_t)needles;
            status = step_needles(s->row.sim, needles, r->poses + at, r->options->dt, r->outputs + at, &reason);
        }
        atomic_fetch_add(&r->ticks, done - before);
        if (member == 0) look(r);
    }
    if (status == TROCAR_OK) return;
    size_t at = first + (size_t)done * (size_t)needles;
    memset(r->outputs + at, 0, (size_t)(r->steps - done) * (size_t)needles * sizeof *r->outputs);
    first_failure_note(&r->failure, insertion, fail(&why, status, "step %d: %.900s", done, reason.text), &why);
}

/* ---- all ------------------------------------------------------------------------------------------------------------------------- */

trocar_rollout_options trocar_default_rollout_options(void) { return (trocar_rollout_options){.dt = 1e-3, .threads = 1, .needles = 1}; }

static trocar_status check(trocar_model *model, int batch, int steps, const trocar_rollout_options *o, trocar_error *why) {
    if (batch < 0 || steps < 0 || o->threads < 1 || o->threads > MAX_THREADS || o->needles < 1 || o->needles > MAX_NEEDLES)
        return fail(why, TROCAR_BAD_INPUT, "a rollout of %d x %d steps with %d needles in %d threads: 1 to %d needles, 1 to %d threads", batch, steps, o->needles,
                    o->threads, MAX_NEEDLES, MAX_THREADS);
    if (!o->models && !model) return fail(why, TROCAR_BAD_INPUT, "a rollout without a model: give one, or one for each insertion in the options");
    if (o->states && !o->state_sizes) return fail(why, TROCAR_BAD_INPUT, "a rollout with states, but without their sizes");
    for (int i = 0; i < (o->models ? batch : 1); i++) {
        trocar_error wrong;
        trocar_status status = check_driven_needles(o->models ? o->models[i] : model, o->needles, &wrong);
        if (status != TROCAR_OK) return fail(why, status, "insertion %d: %.900s", i, wrong.text);
    }
    return TROCAR_OK;
}

static trocar_status outcome(rollout *r, trocar_error *why) {
    bool finished = atomic_load(&r->ticks) == (long long)r->batch * r->steps;
    if (atomic_load(&r->cancelled) && !finished) return fail(why, TROCAR_CANCELLED, "cancelled");
    const first_failure *f = &r->failure;
    return f->status == TROCAR_OK ? TROCAR_OK : fail(why, f->status, "insertion %d, %.1000s", f->index, f->why.text);
}

trocar_status trocar_rollout(trocar_model *model, const trocar_pose *poses, int batch, int steps, const trocar_rollout_options *given, trocar_output *outputs,
                             trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_rollout_options options = given ? *given : trocar_default_rollout_options();
    if (options.needles == 0) options.needles = 1;
    trocar_status status = check(model, batch, steps, &options, why);
    if (status != TROCAR_OK || batch == 0 || steps == 0) return status;
    memset(outputs, 0, (size_t)batch * (size_t)steps * (size_t)options.needles * sizeof *outputs);
    rollout *r = calloc(1, sizeof *r);
    if (!r) return fail(why, TROCAR_NO_MEMORY, "no memory for a rollout");
    *r = (rollout){.options = &options, .model = model, .poses = poses, .batch = batch, .steps = steps, .outputs = outputs};
    int wanted = options.threads < batch ? options.threads : batch;
    status = take_seats(r, wanted, why);
    if (status == TROCAR_OK) {
        team *threads = team_create(r->seat_count);
        if (team_members(threads) < wanted)
            host_log(&model_of(r, 0)->log, TROCAR_LOG_WARNING, "the rollout has %d of %d threads: no memory for more", team_members(threads), wanted);
        first_failure_create(&r->failure);
        team_run_watched(threads, batch, run_insertion, r, look);
        team_free(threads);
        look(r);
        status = outcome(r, why);
        first_failure_free(&r->failure);
    }
    for (int i = 0; i < r->seat_count; i++) row_free(&r->seats[i].row);
    free(r);
    return status;
}
