/* bench_implants: does many implants in one simulation, one after another, as over days of use, to check that memory does not grow. Needles are inserted,
   drop seeds, rest, and are taken and withdrawn in random order. One is removed while it rests, and a state is saved and restored in between. Every tenth
   implant is the same and must give the same forces.

   usage: bench_implants [COUNT [SCENE]]     by default 200 meshes/figure8.yaml. Exit status 1 if the resident memory after the last implant is more than 1 %
   above that after the first tenth of the implants, or if the force on a hand differs from that in the identical implant by more than 1e-6 of the peak
   force. */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

#include "live_sim.h"
#include "trocar.h"

enum { NEEDLES = 4, DEPTH = 25, CLEAR = 5, KINDS = 10 }; /* DEPTH, CLEAR: mm; KINDS: number of different implants */

static trocar_error why;
#define OK(call) must(call, "bench_implants: " #call, &why)

static const trocar_pose AWAY = {{0, 0, -10}, {1, 0, 0, 0}};

static long resident_kib(void) {
    char line[256];
    long kib = -1;
    FILE *file = fopen("/proc/self/status", "r");
    while (file && fgets(line, sizeof line, file) && sscanf(line, "VmRSS: %ld", &kib) != 1) continue;
    if (file) fclose(file);
    return kib;
}

/* first: largest axial force on the hand while each needle is inserted and withdrawn, in the first implant of each kind, N; peak: largest of all forces, N;
   drift: largest difference from the first implant of the same kind, N */
static double first[KINDS][NEEDLES][2], peak, drift;

static void compare(int kind, bool again, int needle, bool out, double force) {
    peak = fmax(peak, force);
    if (!again) first[kind][needle][out] = force;
    drift = fmax(drift, fabs(force - first[kind][needle][out]));
}

/* Moves at 0.2 m/s, updating `most` with the largest axial force. */
static int move(trocar_sim *sim, int needle, trocar_pose *base, int mm, double *most) {
    trocar_output out;
    int ticks = 5 * abs(mm);
    for (int t = 0; t < ticks; t++) {
        base->position[2] += 1e-3 * mm / ticks;
        OK(trocar_sim_step(sim, needle, base, 1e-3, &out, &why));
        *most = fmax(*most, fabs(out.force[2]));
    }
    return ticks;
}

/* Shuffles into a pseudo-random order, the same for all implants of one kind. */
static void shuffle(int kind, int order[NEEDLES]) {
    srand((unsigned)kind);
    for (int k = 0; k < NEEDLES; k++) {
        int other = rand() % (k + 1);
        order[k] = order[other];
        order[other] = k;
    }
}

static int implant(trocar_sim *sim, int number, void *state, size_t size) {
    int ticks = 0, order[NEEDLES];
    shuffle(number % KINDS, order);
    for (int k = 0; k < NEEDLES; k++) {
        double most = 0.0;
        trocar_pose base = {{5e-3 * (k % 2) + 1e-4 * (number % KINDS), 5e-3 * (k / 2), -0.201}, {1, 0, 0, 0}};
        OK(trocar_sim_reset(sim, k, &base, &why));
        ticks += move(sim, k, &base, DEPTH, &most);
        OK(trocar_sim_drop_seeds(sim, k, 1, 0.0, &why));
        ticks += move(sim, k, &base, -8, &most);
        compare(number % KINDS, number > KINDS, k, false, most);
        OK(trocar_sim_leave(sim, k, &why));
        OK(trocar_sim_work(sim, NULL, &why));
    }
    OK(trocar_sim_save(sim, state, size, &why));
    OK(trocar_sim_reset(sim, 1, &AWAY, &why)); /* it rests */
    OK(trocar_sim_work(sim, NULL, &why));
    OK(trocar_sim_restore(sim, state, size, &why));
    for (int i = 0; i < NEEDLES; i++) {
        int k = order[i];
        OK(trocar_sim_take(sim, k, &why));
        OK(trocar_sim_work(sim, NULL, &why));
        double most = 0.0;
        trocar_pose base = trocar_view_base(trocar_sim_view(sim), k);
        ticks += move(sim, k, &base, -(DEPTH + CLEAR), &most);
        compare(number % KINDS, number > KINDS, k, true, most);
        OK(trocar_sim_undo_seed(sim, k, &why));
        OK(trocar_sim_reset(sim, k, &AWAY, &why));
    }
    return ticks;
}

int main(int argc, char **argv) {
    int count = argc > 1 ? atoi(argv[1]) : 200, early = count < 10 ? 1 : count / 10;
    const char *path = argc > 2 ? argv[2] : "meshes/figure8.yaml";
    trocar_scene *scene;
    trocar_model *model;
    trocar_sim *sim;
    long before = 0, after = 0;
    double seconds = 0.0;
    OK(trocar_scene_load(path, &scene, &why));
    OK(trocar_scene_set(scene, "needles", "4", &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &sim, &why));
    size_t size = trocar_sim_state_size(sim);
    void *state = malloc(size);
    if (!state) return EXIT_FAILURE;
    for (int k = 0; k < NEEDLES; k++) OK(trocar_sim_reset(sim, k, &AWAY, &why));
    printf("%s, %d needles\nimplants  simulated [s]  resident [KiB]\n", path, NEEDLES);
    for (int i = 1; i <= count; i++) {
        seconds += 1e-3 * implant(sim, i, state, size);
        if (i % early != 0) continue;
        after = resident_kib();
        if (i == early) before = after;
        printf("%8d %14.0f %15ld\n", i, seconds, after);
        fflush(stdout);
    }
    printf("growth from the %dth to the %dth: %.2f %%\n", early, count, 100.0 * (double)(after - before) / (double)before);
    printf("forces: within %.1e N of those in the first implant of the same kind, up to %.2f N\n", drift, peak);
    free(state);
    trocar_sim_free(sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
    return (double)after <= 1.01 * (double)before && drift <= 1e-6 * peak ? EXIT_SUCCESS : EXIT_FAILURE;
}
