/* Compares batches with single simulations stepped one by one. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "cube_mesh.h"
#include "trocar.h"

#include <cmocka.h>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SANITIZED 1 /* the sanitizer's shadow memory reserves most of the address space */
#else
#define SANITIZED 0
#endif

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

static void assert_refused(trocar_status status, const char *words) {
    assert_int_equal(status, TROCAR_BAD_INPUT);
    if (!strstr(why.text, words)) fail_msg("\"%s\" lacks \"%s\"", why.text, words);
}

enum { ROWS = 5, STEPS = 150, NEEDLES = 2, ALL = ROWS * STEPS * NEEDLES };

static trocar_scene *cube_scene(void) {
    cube_mesh *cube = malloc(sizeof *cube);
    trocar_scene *scene;
    cube_create(cube);
    trocar_mesh arrays = cube_arrays(cube);
    OK(trocar_scene_create(&scene, &why));
    OK(trocar_scene_set_mesh(scene, &arrays, &why));
    free(cube);
    OK(trocar_scene_set_number(scene, "regions[body].youngs_modulus", 20e3, &why));
    OK(trocar_scene_set(scene, "membranes[skin].puncture_force", "0.5", &why));
    OK(trocar_scene_set(scene, "fixed", "[back]", &why));
    OK(trocar_scene_set(scene, "needles", "2", &why));
    OK(trocar_scene_set_number(scene, "needle.bevel_slope", 0.05, &why));
    return scene;
}

/* Two models, used alternately by the rows. The model of the even rows has less friction. */
typedef struct {
    trocar_model *made[2];
    trocar_model *of_row[ROWS];
} models;

static models models_made(void) {
    models m;
    for (int i = 0; i < 2; i++) {
        trocar_scene *scene = cube_scene();
        OK(trocar_scene_set_number(scene, "regions[body].friction.kinetic", i ? 7.0 : 4.0, &why));
        OK(trocar_model_create(scene, NULL, &m.made[i], &why));
        trocar_scene_free(scene);
    }
    for (int row = 0; row < ROWS; row++) m.of_row[row] = m.made[row % 2];
    return m;
}

static void models_free(models *m) {
    for (int i = 0; i < 2; i++) trocar_model_free(m->made[i]);
}

static trocar_pose pose_at(int row, int needle, int step) {
    return (trocar_pose){{1e-3 * row + 8e-3 * needle, 2e-3, -0.2005 + 200e-6 * (step + 10 * needle)}, {cos(5e-4 * step), 0, 0, sin(5e-4 * step)}};
}

static trocar_pose poses[ROWS][STEPS][NEEDLES], starts[ROWS][NEEDLES];

static void fill_poses(void) {
    for (int row = 0; row < ROWS; row++)
        for (int n = 0; n < NEEDLES; n++) {
            starts[row][n] = pose_at(row, n, 0);
            for (int s = 0; s < STEPS; s++) poses[row][s][n] = pose_at(row, n, s);
        }
}

typedef struct {
    double force[ALL][3], torque[ALL][3], depth[ALL];
    trocar_pose tip[ALL];
    int32_t contacts[ALL], membrane[ALL], passes[ALL], switches[ALL], seeds[ROWS * STEPS], status[ROWS], done[ROWS];
    uint32_t events[ALL];
} results;

static trocar_batch_outputs arrays_of(results *r) {
    return (trocar_batch_outputs){r->force[0], r->torque[0], r->depth, r->tip, r->contacts, r->events, r->membrane, r->passes, r->switches, r->seeds, r->status, r->done};
}

/* Runs the same steps in single simulations, one after another. */
static void compute_singly(const models *m, results *r) {
    memset(r, 0, sizeof *r);
    for (int row = 0; row < ROWS; row++) {
        trocar_sim *sim;
        OK(trocar_sim_create(m->of_row[row], &sim, &why));
        for (int n = 0; n < NEEDLES; n++) OK(trocar_sim_reset(sim, n, &starts[row][n], &why));
        for (int s = 0; s < STEPS; s++)
            for (int n = 0; n < NEEDLES; n++) {
                size_t at = (size_t)(row * STEPS + s) * NEEDLES + (size_t)n;
                double joints[TROCAR_MAX_JOINTS][3];
                trocar_output out;
                OK(trocar_sim_step(sim, n, &poses[row][s][n], 1e-3, &out, &why));
                memcpy(r->force[at], out.force, sizeof out.force);
                memcpy(r->torque[at], out.torque, sizeof out.torque);
                r->depth[at] = out.depth;
                r->contacts[at] = out.contacts;
                r->events[at] = out.events;
                r->membrane[at] = out.membrane;
                r->passes[at] = out.passes;
                r->switches[at] = out.switches;
                int joint_count = trocar_view_centreline(trocar_sim_view(sim), n, joints[0], TROCAR_MAX_JOINTS);
                memcpy(r->tip[at].position, joints[joint_count - 1], sizeof r->tip[at].position);
            }
        r->done[row] = STEPS;
        trocar_sim_free(sim);
    }
}

static void assert_same(const results *a, const results *b) {
    assert_memory_equal(a->force, b->force, sizeof a->force);
    assert_memory_equal(a->torque, b->torque, sizeof a->torque);
    assert_memory_equal(a->depth, b->depth, sizeof a->depth);
    assert_memory_equal(a->contacts, b->contacts, sizeof a->contacts);
    assert_memory_equal(a->events, b->events, sizeof a->events);
    assert_memory_equal(a->membrane, b->membrane, sizeof a->membrane);
    assert_memory_equal(a->passes, b->passes, sizeof a->passes);
    assert_memory_equal(a->switches, b->switches, sizeof a->switches);
    assert_memory_equal(a->done, b->done, sizeof a->done);
    for (int i = 0; i < ALL; i++) assert_memory_equal(a->tip[i].position, b->tip[i].position, sizeof a->tip[i].position);
}

static trocar_batch *batch_of(const models *m, int threads) {
    trocar_batch *batch;
    const trocar_batch_options options = {.threads = threads, .needles = NEEDLES};
    OK(trocar_batch_create(m->of_row, ROWS, &options, &batch, &why));
    OK(trocar_batch_reset(batch, starts[0], NULL, &why));
    return batch;
}

static results *new_results(void) {
    results *r = calloc(1, sizeof *r);
    assert_non_null(r);
    return r;
}

static void rows_equal_single_simulations(void **state) {
    (void)state;
    models m = models_made();
    results *single = new_results(), *together = new_results(), *again = new_results();
    fill_poses();
    compute_singly(&m, single);
    assert_true(single->contacts[ALL - 1] > 2 && fabs(single->force[ALL - 1][2]) > 0.3);
    assert_memory_not_equal(single->force[0], single->force[STEPS * NEEDLES], STEPS * NEEDLES * sizeof *single->force);
    static const int threads[] = {1, 3, 0};
    for (int k = 0; k < 3; k++) {
        trocar_batch *batch = batch_of(&m, threads[k]);
        trocar_batch_outputs out = arrays_of(together);
        assert_true(trocar_batch_rows(batch) == ROWS && trocar_batch_needles(batch) == NEEDLES && trocar_batch_threads(batch) >= 1);
        OK(trocar_batch_step(batch, poses[0][0], STEPS, 1e-3, NULL, NULL, &out, &why));
        assert_same(together, single);
        for (int i = 0; i < ALL; i++) { /* +z of the tip's orientation is along the needle */
            const double *q = together->tip[i].orientation;
            assert_true(1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]) > 0.99);
        }
        OK(trocar_batch_reset(batch, starts[0], NULL, &why)); /* undoes everything before it, and one call per step gives the same results */
        for (int s = 0; s < STEPS; s++) {
            static trocar_pose now[ROWS][NEEDLES];
            static double force[ROWS][NEEDLES][3];
            for (int row = 0; row < ROWS; row++) memcpy(now[row], poses[row][s], sizeof now[row]);
            out = (trocar_batch_outputs){.force = force[0][0]};
            OK(trocar_batch_step(batch, now[0], 1, 1e-3, NULL, NULL, &out, &why));
            for (int row = 0; row < ROWS; row++) memcpy(again->force[(row * STEPS + s) * NEEDLES], force[row], sizeof force[row]);
        }
        assert_memory_equal(again->force, single->force, sizeof single->force);
        trocar_batch_free(batch);
    }
    free(single), free(together), free(again);
    models_free(&m);
}

static void only_rows_of_the_mask_change(void **state) {
    (void)state;
    models m = models_made();
    fill_poses();
    trocar_batch *batch = batch_of(&m, 2);
    const uint8_t mask[ROWS] = {0, 1, 0, 1, 1};
    results *r = new_results(), *whole = new_results();
    memset(r, 0x55, sizeof *r);
    trocar_batch_outputs out = arrays_of(r), all = arrays_of(whole);
    static trocar_pose given[ROWS][STEPS][NEEDLES];
    for (int row = 0; row < ROWS; row++)
        for (int step = 0; step < STEPS; step++)
            for (int n = 0; n < NEEDLES; n++) given[row][step][n] = mask[row] ? poses[row][step][n] : (trocar_pose){{NAN, 0, 0}, {0, 0, 0, 0}};
    OK(trocar_batch_step(batch, given[0][0], STEPS, 1e-3, mask, NULL, &out, &why));
    for (int row = 0; row < ROWS; row++) {
        assert_true((trocar_view_time(trocar_sim_view(trocar_batch_sim(batch, row))) > 0.0) == mask[row]);
        assert_int_equal(r->done[row], mask[row] ? STEPS : 0x55555555);
        assert_int_equal(r->contacts[row * STEPS * NEEDLES + 5] == 0x55555555, !mask[row]);
    }
    const uint8_t others[ROWS] = {1, 0, 1, 0, 0};
    OK(trocar_batch_reset(batch, starts[0], others, &why));
    OK(trocar_batch_step(batch, poses[0][0], STEPS, 1e-3, others, NULL, &out, &why));
    trocar_batch *second = batch_of(&m, 1);
    OK(trocar_batch_step(second, poses[0][0], STEPS, 1e-3, NULL, NULL, &all, &why));
    assert_same(r, whole);
    free(r), free(whole);
    trocar_batch_free(batch);
    trocar_batch_free(second);
    models_free(&m);
}

static void rows_are_saved_and_restored(void **state) {
    (void)state;
    models m = models_made();
    fill_poses();
    enum { HALF = STEPS / 2 };
    trocar_batch *batch = batch_of(&m, 2);
    static double first[ROWS][HALF][NEEDLES][3], second[ROWS][HALF][NEEDLES][3];
    static trocar_pose early[ROWS][HALF][NEEDLES], late[ROWS][HALF][NEEDLES];
    for (int row = 0; row < ROWS; row++) memcpy(early[row], poses[row], sizeof early[row]), memcpy(late[row], poses[row][HALF], sizeof late[row]);
    trocar_batch_outputs out = {.force = first[0][0][0]};
    OK(trocar_batch_step(batch, early[0][0], HALF, 1e-3, NULL, NULL, &out, &why));
    size_t size = trocar_sim_state_size(trocar_batch_sim(batch, 0)), sizes[ROWS];
    void *states[ROWS];
    for (int row = 0; row < ROWS; row++) states[row] = malloc(size);
    OK(trocar_batch_save(batch, states, size, NULL, &why));
    for (int row = 0; row < ROWS; row++) sizes[row] = trocar_state_bytes(states[row]);
    OK(trocar_batch_step(batch, late[0][0], HALF, 1e-3, NULL, NULL, &out, &why));
    const void *shared[ROWS] = {states[2], states[1], states[2], states[3], states[0]}; /* rows 0, 2 and 4 share a model */
    const size_t of_shared[ROWS] = {sizes[2], sizes[1], sizes[2], sizes[3], sizes[0]};
    OK(trocar_batch_restore(batch, shared, of_shared, NULL, &why));
    memcpy(late[0], late[2], sizeof late[0]);
    memcpy(late[4], poses[0][HALF], sizeof late[4]);
    out.force = second[0][0][0];
    OK(trocar_batch_step(batch, late[0][0], HALF, 1e-3, NULL, NULL, &out, &why));
    assert_memory_equal(second[0], first[2], sizeof first[2]);
    assert_memory_equal(second[1], first[1], sizeof first[1]);
    assert_memory_equal(second[2], first[2], sizeof first[2]);
    assert_memory_equal(second[4], first[0], sizeof first[0]);
    shared[3] = states[0];
    assert_refused(trocar_batch_restore(batch, shared, of_shared, NULL, &why), "row 3: the state belongs to another model");
    assert_refused(trocar_batch_save(batch, states, 8, NULL, &why), "row 0: ");
    for (int row = 0; row < ROWS; row++) free(states[row]);
    trocar_batch_free(batch);
    models_free(&m);
}

static void a_row_takes_another_model(void **state) {
    (void)state;
    models m = models_made();
    fill_poses();
    trocar_batch *batch = batch_of(&m, 2);
    results *r = new_results(), *expected = new_results();
    trocar_batch_outputs out = arrays_of(r);
    OK(trocar_batch_step(batch, poses[0][0], STEPS, 1e-3, NULL, NULL, &out, &why));
    OK(trocar_batch_set_model(batch, 3, m.made[0], &why));
    OK(trocar_batch_reset(batch, starts[0], NULL, &why));
    OK(trocar_batch_step(batch, poses[0][0], STEPS, 1e-3, NULL, NULL, &out, &why));
    m.of_row[3] = m.made[0];
    compute_singly(&m, expected);
    assert_same(r, expected);
    assert_refused(trocar_batch_set_model(batch, ROWS, m.made[0], &why), "row 5");
    free(r), free(expected);
    trocar_batch_free(batch);
    models_free(&m);
}

/* A resting needle is not ticked, but it affects the other needle just as in a single simulation. */
static void a_needle_rests_in_a_row(void **state) {
    (void)state;
    models m = models_made();
    fill_poses();
    trocar_batch *batch = batch_of(&m, 2);
    results *r = new_results();
    trocar_batch_outputs out = arrays_of(r);
    trocar_sim *single;
    trocar_output output;
    OK(trocar_batch_step(batch, poses[0][0], STEPS, 1e-3, NULL, NULL, &out, &why));
    OK(trocar_sim_create(m.of_row[0], &single, &why));
    for (int n = 0; n < NEEDLES; n++) OK(trocar_sim_reset(single, n, &starts[0][n], &why));
    for (int s = 0; s < STEPS; s++)
        for (int n = 0; n < NEEDLES; n++) OK(trocar_sim_step(single, n, &poses[0][s][n], 1e-3, &output, &why));
    OK(trocar_sim_leave(trocar_batch_sim(batch, 0), 0, &why));
    OK(trocar_sim_leave(single, 0, &why));
    static trocar_pose last[ROWS][NEEDLES];
    for (int row = 0; row < ROWS; row++) memcpy(last[row], poses[row][STEPS - 1], sizeof last[row]);
    last[0][0].position[0] = NAN; /* not read */
    for (int s = 0; s < 10; s++) {
        last[0][1].position[2] += 5e-5;
        OK(trocar_batch_step(batch, last[0], 1, 1e-3, NULL, NULL, &out, &why));
        OK(trocar_sim_step(single, 1, &last[0][1], 1e-3, &output, &why));
        assert_memory_equal(r->force[1], output.force, sizeof output.force);
        assert_true(r->force[0][2] == 0.0 && r->depth[0] > 0.0 && r->contacts[0] > 0 && r->membrane[0] == -1);
    }
    assert_int_equal(trocar_sim_needle_state(trocar_batch_sim(batch, 0), 0), TROCAR_NEEDLE_RESTING);
    OK(trocar_sim_leave(trocar_batch_sim(batch, 1), 0, &why));
    OK(trocar_sim_leave(trocar_batch_sim(batch, 1), 1, &why)); /* now no needle of this row is ticked */
    for (int s = 0; s < 2; s++) OK(trocar_batch_step(batch, last[0], 1, 1e-3, NULL, NULL, &out, &why));
    for (int n = 0; n < NEEDLES; n++) assert_int_equal(trocar_sim_needle_state(trocar_batch_sim(batch, 1), n), TROCAR_NEEDLE_RESTING);
    free(r);
    trocar_sim_free(single);
    trocar_batch_free(batch);
    models_free(&m);
}

/* ---- failures ---- */

static void bad_input_is_refused_and_other_rows_go_on(void **state) {
    (void)state;
    models m = models_made();
    fill_poses();
    trocar_batch *batch;
    results *r = new_results(), *expected = new_results();
    trocar_batch_outputs out = arrays_of(r);
    compute_singly(&m, expected);
    assert_refused(trocar_batch_create(m.of_row, 0, NULL, &batch, &why), "0 rows");
    assert_null(batch);
    assert_refused(trocar_batch_create(m.of_row, ROWS, &(trocar_batch_options){.threads = 257, .needles = 1}, &batch, &why), "257 threads");
    assert_refused(trocar_batch_create(m.of_row, ROWS, &(trocar_batch_options){.needles = 3}, &batch, &why), "row 0: 3 needles are driven and the model has 2");
    batch = batch_of(&m, 2);
    assert_refused(trocar_batch_step(batch, poses[0][0], -1, 1e-3, NULL, NULL, &out, &why), "-1 steps");
    assert_refused(trocar_batch_step(batch, poses[0][0], 1, 0.0, NULL, NULL, &out, &why), "dt");
    assert_null(trocar_batch_sim(batch, ROWS));
    assert_null(trocar_batch_sim(batch, -1));
    trocar_pose kept = poses[3][70][1];
    poses[3][70][1].position[1] = NAN;
    poses[4][71][0].orientation[0] = 3.0;
    assert_refused(trocar_batch_step(batch, poses[0][0], STEPS, 1e-3, NULL, NULL, &out, &why), "row 3: step 70: the pose is not finite");
    for (int row = 0; row < ROWS; row++) {
        int done = row == 3 ? 70 : row == 4 ? 71 : STEPS;
        size_t at = (size_t)row * STEPS * NEEDLES, good = (size_t)done * NEEDLES;
        assert_int_equal(r->done[row], done);
        assert_int_equal(r->status[row], done < STEPS ? TROCAR_BAD_INPUT : TROCAR_OK);
        assert_memory_equal(r->force[at], expected->force[at], good * sizeof *r->force);
        for (size_t i = at + good; i < at + STEPS * NEEDLES; i++) assert_true(r->force[i][2] == 0.0 && r->events[i] == 0 && r->tip[i].orientation[0] == 0.0);
    }
    starts[1][0].position[0] = NAN;
    assert_refused(trocar_batch_reset(batch, starts[0], NULL, &why), "row 1: ");
    poses[3][70][1] = kept;
    free(r), free(expected);
    trocar_batch_free(batch);
    trocar_batch_free(NULL);
    models_free(&m);
}

typedef struct {
    int calls, until;
    double fraction;
} watcher;

static void note_progress(const char *what, double fraction, void *context) {
    watcher *w = context;
    assert_string_equal(what, "batch");
    assert_true(fraction >= w->fraction && fraction <= 1.0);
    w->fraction = fraction;
}

static int stop_later(void *context) {
    watcher *w = context;
    return ++w->calls > w->until;
}

static void a_call_is_watched_and_cancelled(void **state) {
    (void)state;
    models m = models_made();
    fill_poses();
    results *r = new_results();
    trocar_batch_outputs out = arrays_of(r);
    trocar_batch *batch = batch_of(&m, 1);
    watcher w = {.until = 1000};
    const trocar_watch watch = {note_progress, stop_later, &w};
    OK(trocar_batch_step(batch, poses[0][0], STEPS, 1e-3, NULL, &watch, &out, &why));
    assert_true(w.calls == ROWS * ((STEPS + 63) / 64) && w.fraction == 1.0);
    OK(trocar_batch_reset(batch, starts[0], NULL, &why));
    w = (watcher){.until = ROWS + 1}; /* cancels during the second pass over the rows */
    assert_int_equal(trocar_batch_step(batch, poses[0][0], STEPS, 1e-3, NULL, &watch, &out, &why), TROCAR_CANCELLED);
    for (int row = 0; row < ROWS; row++) {
        int done = row < 2 ? 128 : 64;
        assert_int_equal(r->done[row], done);
        assert_true(r->force[((row * STEPS) + done - 1) * NEEDLES][2] != 0.0 && r->force[(row * STEPS + done) * NEEDLES][2] == 0.0);
    }
    free(r);
    trocar_batch_free(batch);
    models_free(&m);
}

/* After a fork, the batch's threads are gone in the child, but the child can still step the batch. */
static void a_batch_goes_on_after_a_fork(void **state) {
    (void)state;
#ifdef __SANITIZE_THREAD__ /* ThreadSanitizer does not support starting threads after a fork */
    skip();
#endif
    models m = models_made();
    fill_poses();
    results *r = new_results(), *expected = new_results();
    trocar_batch *batch = batch_of(&m, 3);
    trocar_batch_outputs out = arrays_of(r);
    compute_singly(&m, expected);
    pid_t child = fork();
    if (child == 0) {
        alarm(60);
        trocar_status status = trocar_batch_step(batch, poses[0][0], STEPS, 1e-3, NULL, NULL, &out, NULL);
        _exit(status == TROCAR_OK && memcmp(r->force, expected->force, sizeof r->force) == 0 ? 0 : 1);
    }
    int status;
    waitpid(child, &status, 0);
    assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    free(r), free(expected);
    trocar_batch_free(batch);
    models_free(&m);
}

/* A rollout gives the same results as single simulations with the same poses, models and needles. Started from a saved state, it continues the insertion
   from which the state was saved. */
static void rollouts_have_models_needles_and_states(void **state) {
    (void)state;
    enum { HALF = STEPS / 2 };
    models m = models_made();
    results *expected = malloc(sizeof *expected);
    trocar_output *all = calloc(ALL, sizeof *all), *late = calloc(ALL, sizeof *late);
    trocar_pose *rest = calloc(ALL, sizeof *rest);
    void *states[ROWS] = {NULL};
    size_t sizes[ROWS] = {0};
    fill_poses();
    compute_singly(&m, expected);
    for (int threads = 1; threads <= 3; threads += 2) {
        trocar_rollout_options options = {.dt = 1e-3, .threads = threads, .needles = NEEDLES, .models = m.of_row};
        memset(all, 0, ALL * sizeof *all);
        OK(trocar_rollout(NULL, poses[0][0], ROWS, STEPS, &options, all, &why));
        for (int i = 0; i < ALL; i++) {
            assert_memory_equal(all[i].force, expected->force[i], sizeof all[i].force);
            assert_true(all[i].depth == expected->depth[i] && all[i].events == expected->events[i]);
        }
        for (int row = 1; row < ROWS; row++) { /* insertion 0 has no saved state: it begins with a reset at the pose halfway through */
            trocar_sim *sim;
            OK(trocar_sim_create(m.of_row[row], &sim, &why));
            for (int n = 0; n < NEEDLES; n++) OK(trocar_sim_reset(sim, n, &poses[row][0][n], &why));
            for (int s = 0; s < HALF; s++)
                for (int n = 0; n < NEEDLES; n++) {
                    trocar_output ignored;
                    OK(trocar_sim_step(sim, n, &poses[row][s][n], 1e-3, &ignored, &why));
                }
            sizes[row] = trocar_sim_state_size(sim);
            states[row] = realloc(states[row], sizes[row]);
            OK(trocar_sim_save(sim, states[row], sizes[row], &why));
            sizes[row] = trocar_state_bytes(states[row]);
            trocar_sim_free(sim);
        }
        for (int row = 0; row < ROWS; row++) memcpy(rest + (size_t)row * (STEPS - HALF) * NEEDLES, poses[row][HALF], (STEPS - HALF) * sizeof poses[0][0]);
        options.states = (const void *const *)states;
        options.state_sizes = sizes;
        OK(trocar_rollout(NULL, rest, ROWS, STEPS - HALF, &options, late, &why));
        size_t count = (STEPS - HALF) * NEEDLES;
        for (int row = 1; row < ROWS; row++)
            assert_memory_equal(late + (size_t)row * count, all + ((size_t)row * STEPS + HALF) * NEEDLES, count * sizeof *late);
        assert_memory_not_equal(late, all + (size_t)HALF * NEEDLES, count * sizeof *late);
    }
    sizes[2] = 3; /* one corrupt state; the other insertions are still computed */
    trocar_rollout_options options = {.dt = 1e-3, .threads = 2, .needles = NEEDLES, .models = m.of_row, .states = (const void *const *)states, .state_sizes = sizes};
    assert_refused(trocar_rollout(NULL, rest, ROWS, STEPS - HALF, &options, late, &why), "insertion 2, step 0");
    assert_memory_equal(late + (ROWS - 1) * (STEPS - HALF) * NEEDLES, all + ((ROWS - 1) * STEPS + HALF) * NEEDLES, (STEPS - HALF) * NEEDLES * sizeof *late);
    options.state_sizes = NULL;
    assert_refused(trocar_rollout(NULL, rest, ROWS, 1, &options, late, &why), "without their sizes");
    options.states = NULL;
    options.needles = 3;
    assert_refused(trocar_rollout(NULL, rest, ROWS, 1, &options, late, &why), "insertion 0: 3 needles are driven and the model has 2");
    options.models = NULL;
    assert_refused(trocar_rollout(NULL, rest, ROWS, 1, &options, late, &why), "without a model");
    for (int row = 0; row < ROWS; row++) free(states[row]);
    free(expected), free(all), free(late), free(rest);
    models_free(&m);
}

static void limit(rlim_t bytes) { setrlimit(RLIMIT_AS, &(struct rlimit){bytes, RLIM_INFINITY}); }

static size_t mapped(void) {
    FILE *file = fopen("/proc/self/statm", "r");
    long pages = 0;
    if (fscanf(file, "%ld", &pages) != 1) pages = 0;
    fclose(file);
    return (size_t)pages * (size_t)sysconf(_SC_PAGESIZE);
}

static void too_little_memory_is_told(void **state) {
    (void)state;
    if (SANITIZED) skip();
    models m = models_made();
    fill_poses();
    trocar_batch *batch = batch_of(&m, 2);
    trocar_batch_free(batch); /* creating the batch made BLAS allocate its memory for two threads */
    int told = 0, made = 0;
    for (double room = 5e6; room < 600e6; room *= 1.3) {
        limit(mapped() + (size_t)room);
        trocar_status status = trocar_batch_create(m.of_row, ROWS, &(trocar_batch_options){.threads = 2, .needles = NEEDLES}, &batch, &why);
        limit(RLIM_INFINITY);
        assert_true(status == TROCAR_OK || status == TROCAR_NO_MEMORY);
        assert_true((status == TROCAR_OK) == (batch != NULL));
        told += status == TROCAR_NO_MEMORY;
        made += status == TROCAR_OK;
        trocar_batch_free(batch);
    }
    assert_true(told > 2 && made > 0);
    models_free(&m);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rows_equal_single_simulations),
        cmocka_unit_test(only_rows_of_the_mask_change),
        cmocka_unit_test(rows_are_saved_and_restored),
        cmocka_unit_test(a_row_takes_another_model),
        cmocka_unit_test(a_needle_rests_in_a_row),
        cmocka_unit_test(bad_input_is_refused_and_other_rows_go_on),
        cmocka_unit_test(a_call_is_watched_and_cancelled),
        cmocka_unit_test(a_batch_goes_on_after_a_fork),
        cmocka_unit_test(rollouts_have_models_needles_and_states),
        cmocka_unit_test(too_little_memory_is_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
