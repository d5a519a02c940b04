/* Tests, through trocar.h, views of a simulation and of its snapshots, simulated time, default options and the log. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cube_mesh.h"

#include <cmocka.h>

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

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
    return scene;
}

static trocar_model *create(trocar_scene *scene, const trocar_model_options *options) {
    trocar_model *model;
    OK(trocar_model_create(scene, options, &model, &why));
    trocar_scene_free(scene);
    return model;
}

/* Returns the base's pose during an insertion at 50 mm/s; the needles are 20 mm apart. */
static trocar_pose pose_at(int needle, int tick) { return (trocar_pose){{-10e-3 + 20e-3 * needle, 2e-3, -0.2005 + 50e-6 * tick}, {1, 0, 0, 0}}; }

static trocar_output step(trocar_sim *sim, int needle, int tick, double dt) {
    trocar_output out;
    trocar_pose base = pose_at(needle, tick);
    OK(trocar_sim_step(sim, needle, &base, dt, &out, &why));
    return out;
}

static trocar_sim *sim_at_start(trocar_model *model) {
    trocar_sim *sim;
    OK(trocar_sim_create(model, &sim, &why));
    for (int needle = 0; needle < 2; needle++) {
        trocar_pose start = pose_at(needle, 0);
        OK(trocar_sim_reset(sim, needle, &start, &why));
    }
    return sim;
}

/* ---- views ---- */

typedef struct {
    double time;
    struct {
        trocar_pose base;
        double joints[TROCAR_MAX_JOINTS][3], tip_lead, energy;
        trocar_contact contacts[TROCAR_MAX_POINTS], pending[TROCAR_MAX_POINTS];
        trocar_track_point tracks[TROCAR_MAX_TRACK_POINTS];
        int joint_count, contact_count, pending_count, hole, track_count, pending_seeds;
    } needles[2];
    trocar_seed seeds[TROCAR_MAX_SEEDS];
    int seed_count;
    trocar_probe probe;
    double displacements[CUBE_NODES][3];
} sight;

static sight *look(const trocar_view *view) {
    sight *s = calloc(1, sizeof *s);
    s->time = trocar_view_time(view);
    for (int n = 0; n < 2; n++) {
        s->needles[n].base = trocar_view_base(view, n);
        s->needles[n].joint_count = trocar_view_centreline(view, n, s->needles[n].joints[0], TROCAR_MAX_JOINTS);
        s->needles[n].tip_lead = trocar_view_tip_lead(view, n);
        s->needles[n].energy = trocar_view_needle_energy(view, n);
        s->needles[n].contact_count = trocar_view_contacts(view, n, s->needles[n].contacts, TROCAR_MAX_POINTS);
        s->needles[n].pending_count = trocar_view_pending_contacts(view, n, s->needles[n].pending, TROCAR_MAX_POINTS);
        s->needles[n].hole = trocar_view_hole(view, n, 0);
        s->needles[n].track_count = trocar_view_tracks(view, n, s->needles[n].tracks, TROCAR_MAX_TRACK_POINTS);
        s->needles[n].pending_seeds = trocar_view_pending_seeds(view, n);
    }
    s->seed_count = trocar_view_seeds(view, s->seeds, TROCAR_MAX_SEEDS);
    s->probe = trocar_view_probe(view);
    OK(trocar_view_displacements(view, s->displacements[0], &why));
    return s;
}

/* A snapshot and a copy of it show the same data as the simulation, byte for byte, and still do after the simulation has ticked on. */
static void a_picture_shows_what_the_simulation_showed(void **state) {
    (void)state;
    trocar_model *model = create(cube_scene(), NULL);
    trocar_sim *sim = sim_at_start(model);
    trocar_picture *picture, *copy;
    OK(trocar_picture_create(model, &picture, &why));
    OK(trocar_picture_create(model, &copy, &why));
    trocar_sim_set_base_compliance(sim, 0, 1e-3); /* makes the base's position differ from the one passed to the tick */
    for (int tick = 0; tick < 400; tick++) {
        step(sim, 0, tick, 1e-3);
        step(sim, 1, tick, 1e-3);
    }
    OK(trocar_sim_drop_seeds(sim, 0, 1, 0.0, &why));
    const trocar_view *view = trocar_sim_view(sim);
    int tick = 400;
    while (trocar_view_pending_seeds(view, 0) > 0) step(sim, 0, tick--, 1e-3);
    trocar_sim_take_picture(sim, picture);
    trocar_picture_copy(picture, copy);
    sight *now = look(view);
    assert_true(now->time > 0.4 && now->seed_count == 1 && now->needles[0].contact_count > 0 && now->needles[1].contact_count > 1);
    assert_true(now->needles[0].energy > 0.0 && now->needles[0].track_count > 2 && now->needles[0].hole == TROCAR_NO_HOLE && !now->probe.placed);
    assert_true(fabs(now->needles[0].base.position[2] - pose_at(0, tick + 1).position[2]) > 1e-6);
    for (int i = 0; i < 10; i++) step(sim, 0, tick--, 1e-3);
    assert_ptr_equal(trocar_sim_view(sim), view);
    sight *in_picture = look(trocar_picture_view(picture)), *in_copy = look(trocar_picture_view(copy)), *later = look(view);
    assert_memory_equal(in_picture, now, sizeof *now);
    assert_memory_equal(in_copy, now, sizeof *now);
    assert_memory_not_equal(later, now, sizeof *now);
    free(now), free(in_picture), free(in_copy), free(later);
    trocar_picture_free(picture);
    trocar_picture_free(copy);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* ---- time ---- */

static double time_of(const trocar_sim *sim) { return trocar_view_time(trocar_sim_view(sim)); }

static void assert_time(const trocar_sim *sim, double expected) {
    if (fabs(time_of(sim) - expected) > 1e-12) fail_msg("%.15g s instead of %.15g s", time_of(sim), expected);
}

static void time_advances_by_dt(void **state) {
    (void)state;
    trocar_model *model = create(cube_scene(), NULL);
    trocar_sim *sim = sim_at_start(model);
    trocar_output out;
    trocar_pose base = pose_at(0, 0);
    assert_true(time_of(sim) == 0.0);
    step(sim, 0, 0, 1e-3);
    assert_true(time_of(sim) == 1e-3);
    for (int tick = 0; tick < 10; tick++) step(sim, 0, tick, 2e-3);
    assert_time(sim, 0.021);
    OK(trocar_sim_tick(sim, 0, &base, 5e-4, &out)); /* simulated time advances in real-time mode as it does in lockstep */
    assert_time(sim, 0.0215);
    assert_int_equal(trocar_sim_tick(sim, 0, &base, 0.0, &out), TROCAR_BAD_INPUT);
    assert_int_equal(trocar_sim_step(sim, 7, &base, 1e-3, &out, &why), TROCAR_BAD_INPUT);
    OK(trocar_sim_reset(sim, 0, &base, &why));
    assert_time(sim, 0.0215); /* neither a refused tick nor a reset advances simulated time */
    trocar_sim_free(sim);
    trocar_model_free(model);
}

static void needles_share_time(void **state) {
    (void)state;
    trocar_model *model = create(cube_scene(), NULL);
    trocar_sim *sim = sim_at_start(model);
    for (int tick = 0; tick < 10; tick++)
        for (int needle = 0; needle < 2; needle++) step(sim, needle, tick, 1e-3);
    assert_time(sim, 0.010);
    for (int tick = 0; tick < 10; tick++) step(sim, 1, tick, 1e-3); /* one alone */
    assert_time(sim, 0.020);
    for (int tick = 0; tick < 10; tick++) { /* needle 0 ticks at half the rate of needle 1 */
        step(sim, 1, tick, 1e-3);
        if (tick % 2 == 0) step(sim, 0, tick, 1e-3);
    }
    assert_time(sim, 0.030);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

static void time_is_saved_and_restored(void **state) {
    (void)state;
    trocar_model *model = create(cube_scene(), NULL);
    trocar_sim *sim = sim_at_start(model), *other = sim_at_start(model);
    for (int tick = 0; tick < 30; tick++) step(sim, 0, tick, 1e-3);
    step(sim, 1, 0, 1e-3); /* belongs to the same round of ticks as needle 0's last step */
    size_t size = trocar_sim_state_size(sim);
    void *saved = malloc(size);
    OK(trocar_sim_save(sim, saved, size, &why));
    double then = time_of(sim);
    for (int tick = 30; tick < 60; tick++) step(sim, 0, tick, 1e-3);
    assert_true(time_of(sim) > then + 0.029);
    OK(trocar_sim_restore(sim, saved, size, &why));
    OK(trocar_sim_restore(other, saved, size, &why));
    assert_true(time_of(sim) == then && time_of(other) == then);
    step(other, 1, 1, 1e-3); /* needle 1 already ticked in the saved round, so this tick starts a new one */
    assert_time(other, then + 1e-3);
    free(saved);
    trocar_sim_free(sim);
    trocar_sim_free(other);
    trocar_model_free(model);
}

/* ---- options ---- */

static void insert(trocar_model *model, trocar_output *outputs) {
    trocar_sim *sim = sim_at_start(model);
    for (int tick = 0; tick < 60; tick++) outputs[tick] = step(sim, 0, 6 * tick, 6e-3); /* long ticks, which are split into several steps */
    trocar_sim_free(sim);
}

/* Default, missing and zeroed options give the same result; any other value makes a difference. */
static void default_options_are_those_without_options(void **state) {
    (void)state;
    static trocar_output without[60], with[60], zeroed[60], other[60];
    trocar_model_options defaults = trocar_default_model_options(), zero, one_step = defaults;
    memset(&zero, 0, sizeof zero);
    assert_true(!defaults.watch.progress && !defaults.watch.cancelled && !defaults.log.write && !defaults.mesh_only && !defaults.keep_inverse);
    assert_true(defaults.max_substeps > 1);
    one_step.max_substeps = 1;
    const trocar_model_options *options[] = {NULL, &defaults, &zero, &one_step};
    trocar_output *outputs[] = {without, with, zeroed, other};
    for (int i = 0; i < 4; i++) {
        trocar_model *model = create(cube_scene(), options[i]);
        insert(model, outputs[i]);
        trocar_model_free(model);
    }
    assert_true(fabs(without[59].force[2]) > 0.1);
    assert_memory_equal(with, without, sizeof without);
    assert_memory_equal(zeroed, without, sizeof without);
    assert_memory_not_equal(other, without, sizeof without);
}

static void default_rollout_options_are_those_without_options(void **state) {
    (void)state;
    enum { BATCH = 2, STEPS = 200 };
    static trocar_pose poses[BATCH][STEPS];
    static trocar_output without[BATCH][STEPS], with[BATCH][STEPS], slower[BATCH][STEPS];
    trocar_rollout_options defaults = trocar_default_rollout_options(), slow = defaults;
    assert_true(defaults.dt == 1e-3 && defaults.threads == 1 && !defaults.watch.progress && !defaults.watch.cancelled);
    for (int i = 0; i < BATCH; i++)
        for (int tick = 0; tick < STEPS; tick++) poses[i][tick] = pose_at(i, tick);
    trocar_model *model = create(cube_scene(), NULL);
    OK(trocar_rollout(model, poses[0], BATCH, STEPS, NULL, without[0], &why));
    OK(trocar_rollout(model, poses[0], BATCH, STEPS, &defaults, with[0], &why));
    slow.dt = 2e-3;
    OK(trocar_rollout(model, poses[0], BATCH, STEPS, &slow, slower[0], &why));
    assert_memory_equal(with, without, sizeof without);
    assert_memory_not_equal(slower, without, sizeof without);
    trocar_model_free(model);
}

/* ---- log ---- */

typedef struct {
    int count, levels[8];
    char messages[8][1024];
} journal;

static void note(int32_t level, const char *message, void *context) {
    journal *j = context;
    if (j->count == 8) fail_msg("too many messages: %s", message);
    j->levels[j->count] = level;
    snprintf(j->messages[j->count++], sizeof *j->messages, "%s", message);
}

static void the_log_says_what_was_chosen_and_what_is_suspicious(void **state) {
    (void)state;
    journal j = {0};
    trocar_model_options options = trocar_default_model_options();
    options.log = (trocar_log){note, &j};
    trocar_model *model = create(cube_scene(), &options);
    assert_int_equal(j.count, 1);
    assert_int_equal(j.levels[0], TROCAR_LOG_INFO);
    assert_non_null(strstr(j.messages[0], trocar_model_description(model)));
    trocar_model_free(model);
    trocar_scene *odd = cube_scene();
    OK(trocar_scene_set(odd, "needle.length", "5", &why));
    j.count = 0;
    model = create(odd, &options);
    assert_int_equal(j.count, 2);
    assert_int_equal(j.levels[0], TROCAR_LOG_WARNING);
    assert_true(trocar_model_remarks(model)[0] != '\0');
    assert_string_equal(j.messages[0], trocar_model_remarks(model));
    trocar_model_free(model);
}

static void the_log_says_when_an_insertion_starts_over(void **state) {
    (void)state;
    journal j = {0};
    trocar_model_options options = trocar_default_model_options();
    options.log = (trocar_log){note, &j};
    trocar_model *model = create(cube_scene(), &options);
    trocar_sim *sim = sim_at_start(model);
    trocar_output out = {0};
    for (int tick = 0; tick < 200; tick++) step(sim, 1, tick, 1e-3);
    j.count = 0;
    trocar_pose far = {{1e200, 0, 0}, {1, 0, 0, 0}}; /* squaring this coordinate overflows */
    OK(trocar_sim_step(sim, 1, &far, 1e-3, &out, &why));
    assert_true(out.events & TROCAR_EVENT_UNSTABLE);
    assert_int_equal(j.count, 1);
    assert_int_equal(j.levels[0], TROCAR_LOG_WARNING);
    assert_non_null(strstr(j.messages[0], "needle 1"));
    trocar_pose start = pose_at(1, 0);
    OK(trocar_sim_reset(sim, 1, &start, &why));
    for (int tick = 0; tick < 200; tick++) step(sim, 1, tick, 1e-3);
    j.count = 0;
    assert_int_equal(trocar_sim_tick(sim, 1, &far, 1e-3, &out), TROCAR_NUMERIC);
    assert_int_equal(j.count, 0); /* a real-time tick never logs; it returns a status instead */
    trocar_sim_free(sim);
    trocar_model_free(model);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_picture_shows_what_the_simulation_showed), cmocka_unit_test(time_advances_by_dt), cmocka_unit_test(needles_share_time),
        cmocka_unit_test(time_is_saved_and_restored), cmocka_unit_test(default_options_are_those_without_options),
        cmocka_unit_test(default_rollout_options_are_those_without_options), cmocka_unit_test(the_log_says_what_was_chosen_and_what_is_suspicious),
        cmocka_unit_test(the_log_says_when_an_insertion_starts_over)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
