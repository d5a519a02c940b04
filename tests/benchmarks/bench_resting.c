/* bench_resting: what resting needles cost the tick and the worker. Needles are left in the implant scene, through holes of its template; then
   one more is pushed in, once for each number of them, in the same simulation. The worker runs in a thread of its own, as in a server.

   usage: bench_resting [SCENE [COUNT...]]     by default meshes/implant.yaml, 0 1 5 25 */
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <poll.h>

#include "trocar.h"

enum { MOST = TROCAR_MAX_NEEDLES - 1, DEPTH_TICKS = 700, ANSWERS = 100000 };

static trocar_error why;

static void check(trocar_status status, const char *what) {
    if (status == TROCAR_OK) return;
    fprintf(stderr, "bench_resting: %s: %s\n", what, why.text);
    exit(1);
}
#define OK(call) check(call, #call)

static int64_t now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1000000000 * (int64_t)t.tv_sec + t.tv_nsec;
}

static trocar_pose at(double x, double y, double z) { return (trocar_pose){{x, y, z}, {1, 0, 0, 0}}; }

/* Columns and rows of holes 5 mm apart, near the middle: the last one is for the needle that is pushed. */
static trocar_pose hole(int needle, double z) {
    int k = needle + (needle >= 12);
    return needle == MOST ? at(0.0, 0.0, z) : at(0.005 * (k % 5 - 2), 0.005 * (k / 5 - 2), z);
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

/* Times of the ticks in the tissue, s, while a needle is pushed in at 0.1 m/s in real time. */
static int push_timed(trocar_sim *sim, int needle, double *ticks) {
    int count = 0;
    trocar_pose base = hole(MOST, -0.201);
    trocar_output out;
    OK(trocar_sim_reset(sim, needle, &base, &why));
    int64_t next = now();
    for (int t = 0; t < DEPTH_TICKS; t++) {
        base.position[2] += 1e-4;
        int64_t began = now();
        if (trocar_sim_tick(sim, needle, &base, 1e-3, &out) != TROCAR_OK) fprintf(stderr, "a tick failed\n");
        int64_t ended = now();
        if (out.depth > 0.01) ticks[count++] = 1e-9 * (double)(ended - began);
        next += 1000000;
        struct timespec until = {next / 1000000000, next % 1000000000};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
    }
    return count;
}

static void insert_and_leave(trocar_sim *sim, int needle) {
    trocar_pose base = hole(needle, -0.201);
    trocar_output out;
    OK(trocar_sim_reset(sim, needle, &base, &why));
    for (int t = 0; t < DEPTH_TICKS; t++) {
        base.position[2] += 1e-4;
        OK(trocar_sim_step(sim, needle, &base, 1e-3, &out, &why));
    }
    int64_t began = now();
    OK(trocar_sim_leave(sim, needle, &why));
    OK(trocar_sim_work(sim, NULL, &why));
    fprintf(stderr, "needle %d left in %.0f ms\n", needle, 1e-6 * (double)(now() - began));
}

int main(int argc, char **argv) {
    static double ticks[DEPTH_TICKS];
    static worker w;
    const char *path = argc > 1 ? argv[1] : "meshes/implant.yaml";
    int standard[] = {0, 1, 5, 25}, counts[MOST], count = argc > 2 ? argc - 2 : 4, left = 0;
    for (int i = 0; i < count && i < MOST; i++) counts[i] = argc > 2 ? atoi(argv[2 + i]) : standard[i];
    trocar_scene *scene;
    trocar_model *model;
    trocar_sim *sim;
    char needles[16];
    snprintf(needles, sizeof needles, "%d", counts[count - 1] + 1);
    OK(trocar_scene_load(path, &scene, &why));
    OK(trocar_scene_set(scene, "needles", needles, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &sim, &why));
    trocar_sim_set_clock(sim, now);
    int pushed = counts[count - 1];
    for (int i = 0; i <= pushed; i++) { /* outside */
        trocar_pose away = at(0.0, 0.0, -1.0);
        OK(trocar_sim_reset(sim, i, &away, &why));
    }
    printf("%s, inverse %s\nresting  tick p50 [us]  p99    max   ratio   answers  p50 [ms]   p99    max\n", path, trocar_model_inverse(model));
    double first = 0.0;
    for (int c = 0; c < count; c++) {
        while (left < counts[c]) insert_and_leave(sim, left++);
        pthread_t thread;
        w.sim = sim;
        w.count = 0;
        atomic_store(&w.stop, false);
        pthread_create(&thread, NULL, run_worker, &w);
        int n = push_timed(sim, pushed, ticks);
        atomic_store(&w.stop, true);
        pthread_join(thread, NULL);
        qsort(ticks, (size_t)n, sizeof *ticks, by_size);
        qsort(w.latency, (size_t)w.count, sizeof *w.latency, by_size);
        double p50 = quantile(ticks, n, 0.5);
        if (c == 0) first = p50;
        printf("%7d  %8.1f  %10.1f %6.1f  %6.2f   %7d  %8.3f %6.3f %6.3f\n", counts[c], 1e6 * p50, 1e6 * quantile(ticks, n, 0.99), 1e6 * quantile(ticks, n, 1.0),
               p50 / first, w.count, 1e3 * quantile(w.latency, w.count, 0.5), 1e3 * quantile(w.latency, w.count, 0.99), 1e3 * quantile(w.latency, w.count, 1.0));
        fflush(stdout);
    }
    trocar_sim_free(sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
    return 0;
}
