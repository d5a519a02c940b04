/* bench_probe: measures the time that a moving probe adds to the tick and the worker. A needle is pushed in repeatedly, in real time, alternately without
   the probe and with it sliding along the skin beside the needle. The worker runs in its own thread, as in a server.

   usage: bench_probe [SCENE]     by default meshes/implant.yaml; the probe is pressed against its surface "skin" */
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>
#include <sched.h>

#include "live_sim.h"
#include "trocar.h"

enum { DEPTH_TICKS = 700, ROUNDS = 5 };

static trocar_error why;
#define OK(call) must(call, "bench_probe: " #call, &why)

typedef struct {
    histogram ticks, latency, between; /* `between`: time between two solves for the probe */
} measured;

/* Returns the probe's pose: along x, 12 mm from the needle and 3 mm deep, with its tip moving back and forth by 20 mm at 50 mm/s. */
static trocar_pose across(double time) {
    double half = sqrt(0.5), x = 0.02 * fabs(fmod(time / 0.4, 2.0) - 1.0);
    return (trocar_pose){{x - 0.15, -0.012, 0.003 - 0.010}, {half, 0, half, 0}};
}

/* Raises the priority to that of the server's haptic thread, if permitted, or restores the normal one. */
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
    int64_t next = monotonic_ns(), solved = 0;
    for (int t = 0; t < DEPTH_TICKS; t++) {
        base.position[2] += 1e-4;
        trocar_pose at = across(1e-3 * t);
        if (probing && t % 10 == 0) OK(trocar_sim_set_probe(sim, &at, &why));
        int64_t began = monotonic_ns();
        if (trocar_sim_tick(sim, 0, &base, 1e-3, &out) != TROCAR_OK) fprintf(stderr, "a tick failed\n");
        int64_t ended = monotonic_ns();
        if (out.depth > 0.01) histogram_add(&m->ticks, ended - began);
        trocar_probe shown = trocar_view_probe(trocar_sim_view(sim));
        if (probing && memcmp(&shown.base, &last, sizeof last) != 0) {
            if (solved > 0) histogram_add(&m->between, ended - solved);
            solved = ended;
            last = shown.base;
        }
        sleep_until(next += 1000000);
    }
}

int main(int argc, char **argv) {
    static measured results[2];
    static live_worker w;
    const char *path = argc > 1 ? argv[1] : "meshes/implant.yaml";
    trocar_scene *scene;
    trocar_model *model;
    trocar_sim *sim;
    OK(trocar_scene_load(path, &scene, &why));
    OK(trocar_scene_set(scene, "probe.surface", "skin", &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &sim, &why));
    trocar_sim_set_clock(sim, monotonic_ns);
    for (int round = 0; round < 2 * ROUNDS; round++) {
        measured *m = &results[round % 2];
        live_worker_start(&w, sim);
        be_real_time(true);
        push_timed(sim, round % 2, m);
        be_real_time(false);
        live_worker_stop(&w, &m->latency);
    }
    printf("%s, inverse %s\nprobe   p50 [us]   p99      max   answers  p50 [ms]   p99      max   solutions apart p50 [ms]  p99\n", path, trocar_model_inverse(model));
    for (int i = 0; i < 2; i++) {
        const measured *m = &results[i];
        printf("%-7s", i ? "moving" : "away");
        print_times(&m->ticks, 1e6, 8, 1);
        printf("  %7lld ", (long long)m->latency.count);
        print_times(&m->latency, 1e3, 8, 3);
        printf(" %14.1f %6.1f\n", 1e3 * histogram_quantile(&m->between, 0.5), 1e3 * histogram_quantile(&m->between, 0.99));
    }
    printf("tick p99, ratio %.2f\n", histogram_quantile(&results[1].ticks, 0.99) / histogram_quantile(&results[0].ticks, 0.99));
    trocar_sim_free(sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
    return 0;
}
