/* trocar.h: many ticks per call, and many insertions in parallel on one model. */
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "api/api.h"
#include "base/host_log.h"
#include "base/host_watch.h"
#include "tissue/blas.h"

/* ---- one insertion ----------------------------------------------------------------------------------------------------- */

/* Runs the next poses, beginning with number `*done`, until the watch has to be called again. */
static trocar_status run_some(trocar_sim *sim, int needle, const trocar_pose *poses, int steps, double dt, int *done, trocar_output *outputs, report *why) {
    int end = steps - *done < TICKS_BETWEEN_LOOKS ? steps : *done + TICKS_BETWEEN_LOOKS;
    trocar_status status = TROCAR_OK;
    for (; *done < end && status == TROCAR_OK; *done += status == TROCAR_OK) status = trocar_sim_step(sim, needle, &poses[*done], dt, &outputs[*done], why);
    return status;
}

trocar_status trocar_sim_run(trocar_sim *sim, int needle, const trocar_pose *poses, int steps, double dt, const trocar_watch *watch, trocar_output *outputs,
                             trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (steps < 0) return fail(why, TROCAR_BAD_INPUT, "%d steps: expected 0 or more", steps);
    trocar_status status = TROCAR_OK;
    report reason;
    int done = 0;
    memset(outputs, 0, (size_t)steps * sizeof *outputs);
    while (done < steps && status == TROCAR_OK) {
        status = run_some(sim, needle, poses, steps, dt, &done, outputs, &reason);
        watch_report(watch, "run", (double)done / steps);
        if (status == TROCAR_OK && done < steps && watch_cancels(watch)) status = fail(&reason, TROCAR_CANCELLED, "cancelled");
    }
    if (status == TROCAR_OK) return status;
    memset(outputs + done, 0, (size_t)(steps - done) * sizeof *outputs);
    return fail(why, status, "step %d: %.900s", done, reason.text);
}

/* ---- many --------------------------------------------------------------------------------------------------------------- */

typedef struct {
    trocar_model *model;
    const trocar_pose *poses;
    int batch, steps;
    double dt;
    const trocar_watch *watch;
    trocar_output *outputs;
    atomic_int next;         /* index of the first insertion that no thread has started */
    atomic_bool cancelled;
    int64_t reported;        /* ticks reported to the watch; used by the calling thread only */
    pthread_mutex_t lock;    /* protects the members below */
    pthread_cond_t changed;
    int64_t ticks;           /* ticks completed in all insertions */
    int running;             /* number of running threads, not counting the caller's */
    trocar_status status, unable; /* status of the first insertion that failed, and of the first thread that could not allocate a simulation */
    report why, why_unable;
} rollout;

static void note(rollout *r, trocar_status status, const report *reason, trocar_status *first, report *why) {
    pthread_mutex_lock(&r->lock);
    if (*first == TROCAR_OK) {
        *first = status;
        *why = *reason;
    }
    pthread_mutex_unlock(&r->lock);
}

/* Reports progress; called by the calling thread without the lock. */
static void look(rollout *r, int64_t ticks) {
    r->reported = ticks;
    watch_report(r->watch, "rollout", (double)ticks / ((double)r->batch * r->steps));
    if (watch_cancels(r->watch)) atomic_store(&r->cancelled, true);
}

static void note_ticks(rollout *r, int count, bool caller) {
    pthread_mutex_lock(&r->lock);
    int64_t ticks = r->ticks += count;
    pthread_cond_signal(&r->changed);
    pthread_mutex_unlock(&r->lock);
    if (caller) look(r, ticks);
}

static trocar_status run_one(rollout *r, trocar_sim *sim, const void *fresh, size_t size, int index, bool caller, report *why) {
    const trocar_pose *poses = r->poses + (size_t)index * (size_t)r->steps;
    trocar_output *outputs = r->outputs + (size_t)index * (size_t)r->steps;
    report reason;
    trocar_status status = trocar_sim_restore(sim, fresh, size, &reason);
    if (status == TROCAR_OK) status = trocar_sim_reset(sim, 0, &poses[0], &reason);
    int done = 0;
    while (done < r->steps && status == TROCAR_OK && !atomic_load(&r->cancelled)) {
        int before = done;
        status = run_some(sim, 0, poses, r->steps, r->dt, &done, outputs, &reason);
        note_ticks(r, done - before, caller);
    }
    if (status == TROCAR_OK) return status;
    memset(outputs + done, 0, (size_t)(r->steps - done) * sizeof *outputs);
    return fail(why, status, "insertion %d, step %d: %.900s", index, done, reason.text);
}

/* Every insertion starts from the same fresh state, so its result does not depend on which thread runs it or on earlier insertions. A thread that cannot
   allocate memory exits and leaves its insertions to the others. */
static void take_part(rollout *r, bool caller) {
    report why;
    trocar_sim *sim;
    trocar_status status = trocar_sim_create(r->model, &sim, &why);
    size_t size = 0;
    void *fresh = NULL;
    if (status == TROCAR_OK) status = sim_save_new(sim, &fresh, &size, &why);
    if (status != TROCAR_OK) note(r, status, &why, &r->unable, &r->why_unable);
    while (status == TROCAR_OK && !atomic_load(&r->cancelled)) {
        int index = atomic_fetch_add(&r->next, 1);
        if (index >= r->batch) break;
        trocar_status one = run_one(r, sim, fresh, size, index, caller, &why);
        if (one != TROCAR_OK) note(r, one, &why, &r->status, &r->why);
    }
    free(fresh);
    trocar_sim_free(sim);
}

static void *run(void *context) {
    rollout *r = context;
    take_part(r, false);
    pthread_mutex_lock(&r->lock);
    r->running--;
    pthread_cond_signal(&r->changed);
    pthread_mutex_unlock(&r->lock);
    return NULL;
}

/* When no insertion is left to start, the calling thread reports progress until the other threads have finished. */
static void wait_for_others(rollout *r) {
    pthread_mutex_lock(&r->lock);
    while (r->running > 0 || r->reported < r->ticks) {
        int64_t ticks = r->ticks;
        if (ticks == r->reported) {
            pthread_cond_wait(&r->changed, &r->lock);
            continue;
        }
        pthread_mutex_unlock(&r->lock);
        look(r, ticks);
        pthread_mutex_lock(&r->lock);
    }
    pthread_mutex_unlock(&r->lock);
}

static trocar_status outcome(const rollout *r, report *why) {
    if (r->cancelled && r->ticks < (int64_t)r->batch * r->steps) return fail(why, TROCAR_CANCELLED, "cancelled");
    if (r->status != TROCAR_OK) {
        *why = r->why;
        return r->status;
    }
    if (r->next >= r->batch) return TROCAR_OK;
    *why = r->why_unable; /* no thread could start */
    return r->unable;
}

trocar_rollout_options trocar_default_rollout_options(void) { return (trocar_rollout_options){.dt = 1e-3, .threads = 1}; }

/* Starts as many of the `wanted` threads as memory and the system allow. Returns their number. */
static int start_threads(rollout *r, int wanted, pthread_t *thread) {
    report ignored;
    int started = 0;
    while (wanted > 0 && blas_make_room(wanted + 1, &ignored) != TROCAR_OK) wanted--;
    r->running = wanted;
    while (started < wanted && pthread_create(&thread[started], NULL, run, r) == 0) started++;
    pthread_mutex_lock(&r->lock);
    r->running -= wanted - started;
    pthread_mutex_unlock(&r->lock);
    return started;
}

trocar_status trocar_rollout(trocar_model *model, const trocar_pose *poses, int batch, int steps, const trocar_rollout_options *given, trocar_output *outputs,
                             trocar_error *error) {
    enum { MAX_THREADS = 256 };
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_rollout_options options = given ? *given : trocar_default_rollout_options();
    pthread_t thread[MAX_THREADS];
    if (batch < 0 || steps < 0 || options.threads < 1 || options.threads > MAX_THREADS)
        return fail(why, TROCAR_BAD_INPUT, "a rollout of %d x %d steps in %d threads: from 1 to %d threads", batch, steps, options.threads, MAX_THREADS);
    if (batch == 0 || steps == 0) return TROCAR_OK;
    rollout r = {.model = model, .poses = poses, .batch = batch, .steps = steps, .dt = options.dt, .watch = &options.watch, .outputs = outputs};
    memset(outputs, 0, (size_t)batch * (size_t)steps * sizeof *outputs);
    pthread_mutex_init(&r.lock, NULL);
    pthread_cond_init(&r.changed, NULL);
    int wanted = options.threads < batch ? options.threads : batch;
    int started = start_threads(&r, wanted - 1, thread);
    if (started < wanted - 1) host_log(&model->log, TROCAR_LOG_WARNING, "the rollout has %d of %d threads: no memory for more", started + 1, wanted);
    take_part(&r, true); /* if no other thread could be started, the calling thread runs all insertions */
    wait_for_others(&r);
    for (int i = 0; i < started; i++) pthread_join(thread[i], NULL);
    pthread_cond_destroy(&r.changed);
    pthread_mutex_destroy(&r.lock);
    return outcome(&r, why);
}
