/* bench_probe: what a moving probe costs the tick and the worker. A needle is pushed in again and again, in real time, by turns without the probe
   and with it sliding along in the skin beside the needle. The worker runs in a thread of its own, as in a server.

   usage: bench_probe [SCENE]     by default meshes/implant.yaml; its surface "skin" is pressed */
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <poll.h>
#include <sched.h>

#include "trocar.h"

enum { DEPTH_TICKS = 700, ROUNDS = 5, ANSWERS = 100000 };

static trocar_error why;

static void check(trocar_status status, const char *what) {
    if (status == TROCAR_OK) return;
    fprintf(stderr, "bench_probe: %s: %s\n", what, why.text);
    exit(1);
}
#define OK(call) check(call, #call)

static int64_t now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1000000000 * (int64_t)t.tv_sec + t.tv_nsec;
}

static int by_size(const void *a, const void *b) {
    double d = *(const double *)a - *(const double *)b;
    return (d > 0.0) - (d < 0.0);
}

static double quantile(double *sorted, int count, double q) { return count ? sorted[(int)(q * (count - 1))] : 0.0; }

/* ---- the worker ----------------------------------------------------------------------------------------------------------- */

typedef struct {
    trocar_sim *sim;
    atomic_bool stop;
    int count;
    double latency[ANSWERS]; /* s */
} worker;

static void *run_worker(void *context) {
    worker *w = context;
    trocar_error failed;
    while (!atomic_load(&w->stop)) {
        struct pollfd wake = {.fd = trocar_sim_work_descriptor(w->sim), .events = POLLIN};
        trocar_work work = {.more = 1};
        poll(&wake, 1, 10);
        while (work.more && !atomic_load(&w->stop)) {
            if (trocar_sim_work(w->sim, &work, &failed) != TROCAR_OK) fprintf(stderr, "worker: %s\n", failed.text);
            if (work.answered && w->count < ANSWERS) w->latency[w->count++] = 1e-9 * (double)work.latency;
        }
    }
    return NULL;
}

/* ---- measurement ------------------------------------------------------------------------------------------------------------- */

typedef struct {
    int count, answers, moves;
    double ticks[ROUNDS * DEPTH_TICKS], latency[ANSWERS], between[ROUNDS * DEPTH_TICKS]; /* s; between: two solutions for the probe */
} measured;

/* Along x, 12 mm beside the needle, 3 mm deep, its tip going back and forth by 20 mm at 50 mm/s. */
static trocar_pose across(double time) {
    double half = sqrt(0.5), x = 0.02 * fabs(fmod(time / 0.4, 2.0) - 1.0);
    return (trocar_pose){{x - 0.15, -0.012, 0.003 - 0.010}, {half, 0, half, 0}};
}

/* As the server's haptic thread, where that is allowed. */
static void be_real_time(bool yes) {
    static bool told;
    struct sched_param priority = {.sched_priority = yes ? 80 : 0};
    if (pthread_setschedparam(pthread_self(), yes ? SCHED_FIFO : SCHED_OTHER, &priority) != 0 && !told) {
        fprintf(stderr, "SCHED_FIFO is not permitted: other programs disturb the ticks\n");
        told = true;
    }
}

static void push_timed(trocar_sim *sim, bool probing, measured *m) {
    trocar_pose base = {{0, 0, -0.201}, {1, 0, 0, 0}}, away = {{0, 0, -1}, {1, 0, 0, 0}}, last = away;
    trocar_output out;
    OK(trocar_sim_set_probe(sim, &away, &why));
    OK(trocar_sim_reset(sim, 0, &base, &why));
    int64_t next = now(), solved = 0;
    for (int t = 0; t < DEPTH_TICKS; t++) {
        base.position[2] += 1e-4;
        trocar_pose at = across(1e-3 * t);
        if (probing && t % 10 == 0) OK(trocar_sim_set_probe(sim, &at, &why));
        int64_t began = now();
        if (trocar_sim_tick(sim, 0, &base, 1e-3, &out) != TROCAR_OK) fprintf(stderr, "a tick failed\n");
        int64_t ended = now();
        if (out.depth > 0.01) m->ticks[m->count++] = 1e-9 * (double)(ended - began);
        trocar_probe shown = trocar_sim_probe(sim);
        if (probing && memcmp(&shown.base, &last, sizeof last) != 0) {
            if (solved > 0) m->between[m->moves++] = 1e-9 * (double)(ended - solved);
            solved = ended;
            last = shown.base;
        }
        next += 1000000;
        struct timespec until = {next / 1000000000, next % 1000000000};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
    }
}

int main(int argc, char **argv) {
    static measured results[2];
    static worker w;
    const char *path = argc > 1 ? argv[1] : "meshes/implant.yaml";
    trocar_scene *scene;
    trocar_model *model;
    OK(trocar_scene_load(path, &scene, &why));
    OK(trocar_scene_set(scene, "probe.surface", "skin", &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &w.sim, &why));
    trocar_sim_set_clock(w.sim, now);
    pthread_t thread;
    for (int round = 0; round < 2 * ROUNDS; round++) {
        measured *m = &results[round % 2];
        w.count = 0;
        atomic_store(&w.stop, false);
        pthread_create(&thread, NULL, run_worker, &w);
        be_real_time(true);
        push_timed(w.sim, round % 2, m);
        be_real_time(false);
        atomic_store(&w.stop, true);
        pthread_join(thread, NULL);
        for (int i = 0; i < w.count && m->answers < ANSWERS; i++) m->latency[m->answers++] = w.latency[i];
    }
    printf("%s, inverse %s\nprobe   tick p50 [us]  p99    max   answers  p50 [ms]   p99    max   solutions apart p50 [ms]  p99\n", path, trocar_model_inverse(model));
    for (int i = 0; i < 2; i++) {
        measured *m = &results[i];
        qsort(m->ticks, (size_t)m->count, sizeof *m->ticks, by_size);
        qsort(m->latency, (size_t)m->answers, sizeof *m->latency, by_size);
        qsort(m->between, (size_t)m->moves, sizeof *m->between, by_size);
        printf("%-7s %8.1f  %10.1f %6.1f  %7d  %8.3f %6.3f %6.3f %14.1f %6.1f\n", i ? "moving" : "away", 1e6 * quantile(m->ticks, m->count, 0.5),
               1e6 * quantile(m->ticks, m->count, 0.99), 1e6 * quantile(m->ticks, m->count, 1.0), m->answers, 1e3 * quantile(m->latency, m->answers, 0.5),
               1e3 * quantile(m->latency, m->answers, 0.99), 1e3 * quantile(m->latency, m->answers, 1.0), 1e3 * quantile(m->between, m->moves, 0.5),
               1e3 * quantile(m->between, m->moves, 0.99));
    }
    printf("tick p99, ratio %.2f\n", quantile(results[1].ticks, results[1].count, 0.99) / quantile(results[0].ticks, results[0].count, 0.99));
    trocar_sim_free(w.sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
    return 0;
}
