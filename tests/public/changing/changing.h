/* Shared setup for the tests in this folder: a hand moves the needle along a straight line while the scene's values change. Each test file builds `scene`
   and `model` once. */
#ifndef TROCAR_TEST_CHANGING_H
#define TROCAR_TEST_CHANGING_H

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "trocar.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

static const double DT = 1e-3, LENGTH = 0.2;

static trocar_scene *scene;
static trocar_model *model; /* shared by all simulations, so the inverse is computed once */

static inline int build_figure8(void **state) {
    (void)state;
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    return 0;
}

static inline int discard(void **state) {
    (void)state;
    trocar_model_free(model);
    trocar_scene_free(scene);
    return 0;
}

static inline trocar_pose base_at(double depth, double aside, double roll) {
    return (trocar_pose){{0.005 + aside, 0.003, depth - LENGTH}, {cos(0.5 * roll), 0, 0, sin(0.5 * roll)}};
}

static inline trocar_sim *sim_of(trocar_model *of) {
    trocar_sim *sim;
    trocar_pose start = base_at(-1e-3, 0, 0);
    OK(trocar_sim_create(of, &sim, &why));
    OK(trocar_sim_reset(sim, 0, &start, &why));
    return sim;
}

static inline trocar_output step_needle(trocar_sim *sim, int needle, trocar_pose base) {
    trocar_output out;
    OK(trocar_sim_step(sim, needle, &base, DT, &out, &why));
    return out;
}

static inline trocar_output step(trocar_sim *sim, trocar_pose base) { return step_needle(sim, 0, base); }

static inline trocar_output step_at(trocar_sim *sim, double depth) { return step(sim, base_at(depth, 0, 0)); }

static inline trocar_output push(trocar_sim *sim, double from, double to, double speed) {
    trocar_output out = {0};
    int ticks = (int)lround(fabs(to - from) / (speed * DT));
    for (int i = 1; i <= ticks; i++) out = step_at(sim, from + (to - from) * i / ticks);
    return out;
}

static inline void change(trocar_sim *sim, const char *lines, double time) {
    trocar_change *c;
    OK(trocar_change_create(sim, &c, &why));
    OK(trocar_change_set(c, lines, &why));
    OK(trocar_change_prepare(c, NULL, &why));
    OK(trocar_sim_change(sim, c, time, &why));
    trocar_change_free(c);
}

/* Releases needle 0, so that it rests in the tissue. */
static inline void let_go(trocar_sim *sim) {
    OK(trocar_sim_leave(sim, 0, &why));
    OK(trocar_sim_work(sim, NULL, &why));
    assert_int_equal(trocar_sim_needle_state(sim, 0), TROCAR_NEEDLE_RESTING);
}

static inline double uniform(unsigned *seed, double low, double high) { return low + (high - low) * rand_r(seed) / RAND_MAX; }

static inline double distance(const double a[3], const double b[3]) {
    double d[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
    return sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
}

/* Makes a scene with other values of some keys, its model and a simulation of it. The caller frees both. */
static inline trocar_sim *sim_with(const char *const keys[], const char *const values[], int count, trocar_model **built) {
    trocar_scene *other;
    OK(trocar_scene_copy(scene, &other, &why));
    for (int i = 0; i < count; i++) OK(trocar_scene_set(other, keys[i], values[i], &why));
    OK(trocar_model_create(other, NULL, built, &why));
    trocar_scene_free(other);
    return sim_of(*built);
}

static inline trocar_output step_of(trocar_sim *sim, int needle, double x, double depth) {
    return step_needle(sim, needle, (trocar_pose){{x, 0.003, depth - LENGTH}, {1, 0, 0, 0}});
}

/* The first key alone makes a scene with two needles; with all keys, the tissue also relaxes. */
static const char *const TWO_KEYS[] = {"needles", "relaxation[0].weight", "relaxation[0].time", "relaxation[1].weight", "relaxation[1].time"};
static const char *const TWO_VALUES[] = {"2", "0.25", "0.15", "0.15", "0.5"};

enum { SETTLED = 300, RELAXED = 5000 }; /* ticks that a needle is held: until elastic tissue has settled; ten times the longest relaxation time constant */

/* Lets one needle rest in the tissue, inserts another 6 mm away, and holds that one pressed to the side. */
static inline trocar_sim *two_needles(trocar_model *of, int ticks) {
    trocar_sim *sim;
    OK(trocar_sim_create(of, &sim, &why));
    for (int i = 0; i < 2; i++) {
        trocar_pose start = {{0.005 + 0.006 * i, 0.003, -1e-3 - LENGTH}, {1, 0, 0, 0}};
        OK(trocar_sim_reset(sim, i, &start, &why));
        for (int t = 0; t <= 500; t++) step_of(sim, i, start.position[0], -1e-3 + 1e-4 * t);
        if (i > 0) break;
        for (int t = 0; t < ticks; t++) step_of(sim, 0, 0.0055, 0.049); /* displaced sideways, so that relaxing tissue remembers a lateral load */
        let_go(sim);
    }
    for (int t = 0; t < 200; t++) step_of(sim, 1, 0.011 + 5e-6 * t, 0.049);
    for (int t = 0; t < ticks; t++) step_of(sim, 1, 0.012, 0.049);
    return sim;
}

/* Returns the just noticeable difference in force (N): 7 % of the force, but at least 0.05 N. */
static inline double noticed(const double force[3]) { return fmax(0.05, 0.07 * distance(force, (double[3]){0})); }

#endif
