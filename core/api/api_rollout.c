/* trocar.h: many insertions side by side on one model. */
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "api/api.h"

typedef struct {
    trocar_model *model;
    const trocar_pose *poses;
    int batch, steps;
    double dt;
    trocar_output *outputs;
    atomic_int next;         /* insertion that nobody has taken yet */
    pthread_mutex_t lock;    /* of the next two */
    trocar_status status;    /* first failure */
    report why;
} rollout;

static void note_failure(rollout *r, trocar_status status, const report *why) {
    pthread_mutex_lock(&r->lock);
    if (r->status == TROCAR_OK) {
        r->status = status;
        r->why = *why;
    }
    pthread_mutex_unlock(&r->lock);
}

static trocar_status run_one(rollout *r, trocar_sim *sim, const void *fresh, size_t size, int index, report *why) {
    const trocar_pose *poses = r->poses + (size_t)index * (size_t)r->steps;
    trocar_output *outputs = r->outputs + (size_t)index * (size_t)r->steps;
    report reason;
    trocar_status status = trocar_sim_restore(sim, fresh, size, &reason);
    if (status == TROCAR_OK) status = trocar_sim_reset(sim, 0, &poses[0], &reason);
    int step = 0;
    for (; step < r->steps && status == TROCAR_OK; step++) status = trocar_sim_step(sim, 0, &poses[step], r->dt, &outputs[step], &reason);
    if (status == TROCAR_OK) return status;
    int failed = step > 0 ? step - 1 : 0;
    memset(outputs + failed, 0, (size_t)(r->steps - failed) * sizeof *outputs);
    return fail(why, status, "insertion %d, step %d: %.900s", index, failed, reason.text);
}

/* Every insertion starts from the same fresh state, so that it does not matter which thread runs it, or after which. */
static void *run(void *context) {
    rollout *r = context;
    report why;
    trocar_sim *sim;
    trocar_status status = trocar_sim_create(r->model, &sim, &why);
    size_t size = status == TROCAR_OK ? trocar_sim_state_size(sim) : 0;
    void *fresh = status == TROCAR_OK ? malloc(size) : NULL;
    if (status == TROCAR_OK && !fresh) status = fail(&why, TROCAR_NO_MEMORY, "no memory for a simulation's state");
    if (status == TROCAR_OK) status = trocar_sim_save(sim, fresh, size, &why);
    if (status != TROCAR_OK) note_failure(r, status, &why);
    while (status == TROCAR_OK) {
        int index = atomic_fetch_add(&r->next, 1);
        if (index >= r->batch) break;
        trocar_status one = run_one(r, sim, fresh, size, index, &why);
        if (one != TROCAR_OK) note_failure(r, one, &why);
    }
    free(fresh);
    trocar_sim_free(sim);
    return NULL;
}

trocar_status trocar_rollout(trocar_model *model, const trocar_pose *poses, int batch, int steps, double dt, int threads,
                             trocar_output *outputs, trocar_error *error) {
    enum { MAX_THREADS = 256 };
    trocar_error ignored, *why = error ? error : &ignored;
    pthread_t thread[MAX_THREADS];
    if (batch < 0 || steps < 0 || threads < 1 || threads > MAX_THREADS)
        return fail(why, TROCAR_BAD_INPUT, "a rollout of %d x %d steps in %d threads: from 1 to %d threads", batch, steps, threads, MAX_THREADS);
    if (batch == 0 || steps == 0) return TROCAR_OK;
    rollout r = {.model = model, .poses = poses, .batch = batch, .steps = steps, .dt = dt, .outputs = outputs};
    memset(outputs, 0, (size_t)batch * (size_t)steps * sizeof *outputs);
    pthread_mutex_init(&r.lock, NULL);
    int started = 0, most = threads < batch ? threads : batch;
    while (started + 1 < most && pthread_create(&thread[started], NULL, run, &r) == 0) started++;
    run(&r); /* this thread is one of them; it does all where no other could be started */
    for (int i = 0; i < started; i++) pthread_join(thread[i], NULL);
    pthread_mutex_destroy(&r.lock);
    if (r.status != TROCAR_OK) *why = r.why;
    return r.status;
}
