/* bench_resting: measures the time that resting needles add to the tick and the worker. Needles are left in the implant scene, through holes of its
   template. Then another is pushed in, five times for each number of resting needles, in the same simulation. The worker runs in its own thread, as in a
   server. Under chrt -f 20, other programs disturb the benchmark as little as they would disturb a server.

   With --processor-time, for a busy machine, ticks and worker alternate in one thread, on a clock that counts the processor time of the worker's calls, as
   if the worker had its own processor. The worker then evicts the ticks' data from the caches, so the tick times cannot be compared with those of the other
   mode.

   usage: bench_resting [--processor-time] [SCENE [COUNT...]]     by default meshes/implant.yaml, 0 1 5 25 */
#include <stdio.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "live_sim.h"
#include "trocar.h"

enum { MOST = TROCAR_MAX_NEEDLES - 1, DEPTH_TICKS = 700, PUSHES = 5 };

static trocar_error why;
#define OK(call) must(call, "bench_resting: " #call, &why)

static trocar_pose at(double x, double y, double z) { return (trocar_pose){{x, y, z}, {1, 0, 0, 0}}; }

/* Returns the pose for a hole near the middle of the template, whose holes are 5 mm apart. The last hole is for the needle being inserted. */
static trocar_pose hole(int needle, double z) {
    int k = needle + (needle >= 12);
    return needle == MOST ? at(0.0, 0.0, z) : at(0.005 * (k % 5 - 2), 0.005 * (k / 5 - 2), z);
}

/* Measures the ticks in the tissue while a needle is inserted at 0.1 m/s in real time. */
static void push_timed(trocar_sim *sim, int needle, histogram *ticks) {
    trocar_pose base = hole(MOST, -0.201);
    trocar_output out;
    OK(trocar_sim_reset(sim, needle, &base, &why));
    int64_t next = monotonic_ns();
    for (int t = 0; t < DEPTH_TICKS; t++) {
        base.position[2] += 1e-4;
        int64_t began = monotonic_ns();
        if (trocar_sim_tick(sim, needle, &base, 1e-3, &out) != TROCAR_OK) fprintf(stderr, "a tick failed\n");
        if (out.depth > 0.01) histogram_add(ticks, monotonic_ns() - began);
        sleep_until(next += 1000000);
    }
}

static int64_t clock_offset; /* ns, the clock of --processor-time minus this thread's CPU time */

static int64_t shared_clock(void) { return processor_ns() + clock_offset; }

static void set_clock(int64_t ns) { clock_offset = ns - processor_ns(); }

/* Measures the ticks with a worker in the same thread. A tick begins at each millisecond of the clock, however long the preceding call of the worker took. */
static void push_by_turns(trocar_sim *sim, int needle, histogram *ticks, histogram *latency) {
    trocar_pose base = hole(MOST, -0.201);
    trocar_output out;
    int64_t worker = 0; /* ns, when the worker's current call ends */
    trocar_sim_set_clock(sim, shared_clock);
    OK(trocar_sim_reset(sim, needle, &base, &why));
    for (int t = 0; t < DEPTH_TICKS; t++) {
        int64_t now = 1000000 * (int64_t)t;
        trocar_work done = {.more = 1};
        base.position[2] += 1e-4;
        set_clock(now);
        if (trocar_sim_tick(sim, needle, &base, 1e-3, &out) != TROCAR_OK) fprintf(stderr, "a tick failed\n");
        if (out.depth > 0.01) histogram_add(ticks, shared_clock() - now);
        if (worker < now) worker = now;
        while (worker < now + 1000000 && done.more) {
            set_clock(worker);
            OK(trocar_sim_work(sim, &done, &why));
            worker = shared_clock();
            if (done.answered) histogram_add(latency, done.latency);
        }
    }
}

static void insert_and_leave(trocar_sim *sim, int needle) {
    trocar_pose base = hole(needle, -0.201);
    trocar_output out;
    OK(trocar_sim_reset(sim, needle, &base, &why));
    for (int t = 0; t < DEPTH_TICKS; t++) {
        base.position[2] += 1e-4;
        OK(trocar_sim_step(sim, needle, &base, 1e-3, &out, &why));
    }
    int64_t began = monotonic_ns();
    OK(trocar_sim_leave(sim, needle, &why));
    OK(trocar_sim_work(sim, NULL, &why));
    fprintf(stderr, "needle %d left in %.0f ms\n", needle, 1e-6 * (double)(monotonic_ns() - began));
}

int main(int argc, char **argv) {
    static histogram ticks, latency;
    static live_worker w;
    bool by_turns = argc > 1 && strcmp(argv[1], "--processor-time") == 0;
    if (by_turns) argv++, argc--;
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
    trocar_sim_set_clock(sim, monotonic_ns);
    int pushed = counts[count - 1];
    for (int i = 0; i <= pushed; i++) { /* outside */
        trocar_pose away = at(0.0, 0.0, -1.0);
        OK(trocar_sim_reset(sim, i, &away, &why));
    }
    printf("%s, inverse %s\nresting   p50 [us]   p99      max   ratio   answers  p50 [ms]   p99      max\n", path, trocar_model_inverse(model));
    double first = 0.0;
    for (int c = 0; c < count; c++) {
        while (left < counts[c]) insert_and_leave(sim, left++);
        histogram_clear(&ticks);
        histogram_clear(&latency);
        for (int push = 0; push < PUSHES && by_turns; push++) push_by_turns(sim, pushed, &ticks, &latency);
        if (!by_turns) {
            live_worker_start(&w, sim);
            for (int push = 0; push < PUSHES; push++) push_timed(sim, pushed, &ticks);
            live_worker_stop(&w, &latency);
        }
        double p50 = histogram_quantile(&ticks, 0.5);
        if (c == 0) first = p50;
        printf("%7d ", counts[c]);
        print_times(&ticks, 1e6, 8, 1);
        printf("  %6.2f   %7lld ", p50 / first, (long long)latency.count);
        print_times(&latency, 1e3, 8, 3);
        putchar('\n');
        fflush(stdout);
    }
    trocar_sim_free(sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
    return 0;
}
