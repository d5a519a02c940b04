/* Tests, through trocar.h, what the library guarantees to any host program: in rare cases, when memory is short, with threads, and when calls are cancelled. */
#include <math.h>
#include <pthread.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "cube_mesh.h"
#include "sanitized.h"

#include <cmocka.h>

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

/* Creates the cube, with bone in the tetrahedra deeper than `bone` (m), or without bone if that is INFINITY. */
static trocar_scene *cube_scene(double bone) {
    static const char *const regions[] = {"body", "bone"};
    cube_mesh *cube = malloc(sizeof *cube);
    int32_t *region = calloc(CUBE_TETS, sizeof *region);
    trocar_scene *scene;
    cube_create(cube);
    for (int t = 0; t < CUBE_TETS; t++) {
        double middle = 0.0;
        for (int c = 0; c < 4; c++) middle += 0.25 * cube->nodes[cube->tets[t][c]][2];
        region[t] = middle > bone;
    }
    trocar_mesh arrays = cube_arrays(cube);
    arrays.tet_region = region;
    arrays.regions = regions;
    arrays.region_count = isfinite(bone) ? 2 : 1;
    OK(trocar_scene_create(&scene, &why));
    OK(trocar_scene_set_mesh(scene, &arrays, &why));
    free(cube);
    free(region);
    OK(trocar_scene_set_number(scene, "regions[body].youngs_modulus", 20e3, &why));
    OK(trocar_scene_set(scene, "membranes[skin].puncture_force", "0.5", &why));
    OK(trocar_scene_set(scene, "fixed", "[back]", &why));
    if (isfinite(bone)) OK(trocar_scene_set(scene, "regions[bone].cutting_force", ".inf", &why));
    return scene;
}

static trocar_model *model_of(trocar_scene *scene) {
    trocar_model *model;
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    return model;
}

static trocar_pose at(double x, double y, double tip) { return (trocar_pose){{x, y, tip - 0.2}, {1, 0, 0, 0}}; }

/* ---- contracts ---------------------------------------------------------------------------------------------------------- */

/* A needle that is reset with its tip in bone counts as inserted. Only the skin counts as punctured, because bone is no membrane and the scene has no
   others. */
static void bone_is_no_membrane(void **state) {
    (void)state;
    trocar_model *model = model_of(cube_scene(0.015));
    trocar_sim *sim;
    OK(trocar_sim_create(model, &sim, &why));
    trocar_pose base = at(1e-3, 2e-3, 0.03);
    OK(trocar_sim_reset(sim, 0, &base, &why));
    trocar_track_point points[TROCAR_MAX_TRACK_POINTS];
    int count = trocar_view_tracks(trocar_sim_view(sim), 0, points, TROCAR_MAX_TRACK_POINTS), skin = 0;
    assert_true(count > 5 && points[count - 1].position[2] > 0.025);
    for (int i = 0; i < count; i++) {
        assert_in_range(points[i].membrane + 1, 0, 1);
        skin += points[i].membrane == 0;
    }
    assert_int_equal(skin, 1);
    for (int t = 0; t < 50; t++) { /* the needle is pushed but does not move, so it punctures nothing */
        trocar_output out;
        base.position[2] += 1e-5;
        OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
        assert_int_equal(out.membrane, -1);
        assert_int_equal(out.events & TROCAR_EVENT_PUNCTURED, 0);
    }
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* A rigid needle is pressed through the tissue onto a fixed bone surface. The force equals the base's travel beyond that surface divided by
   contact.bone_compliance, because nothing else yields. */
static void bone_yields_as_its_key_says(void **state) {
    (void)state;
    for (double compliance = 4e-5; compliance < 2e-4; compliance *= 2.0) {
        trocar_scene *scene = cube_scene(INFINITY);
        trocar_sim *sim;
        trocar_output out;
        OK(trocar_scene_set_number(scene, "contact.bone_compliance", compliance, &why));
        OK(trocar_scene_set_number(scene, "needle.outer_diameter", 4e-3, &why)); /* far from buckling */
        OK(trocar_scene_set_number(scene, "regions[body].cutting_force", 0.0, &why));
        OK(trocar_scene_set_number(scene, "regions[body].friction.static", 0.0, &why));
        OK(trocar_scene_set_number(scene, "regions[body].friction.kinetic", 0.0, &why));
        OK(trocar_scene_set_number(scene, "regions[body].friction.viscous", 0.0, &why));
        OK(trocar_scene_set(scene, "membranes[back].puncture_force", ".inf", &why));
        trocar_model *model = model_of(scene);
        OK(trocar_sim_create(model, &sim, &why));
        trocar_pose base = at(1e-3, 2e-3, -1e-3);
        OK(trocar_sim_reset(sim, 0, &base, &why));
        for (int t = 0; t < 2100; t++, base.position[2] += 2e-5) {
            OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
            double way = base.position[2] + 0.2 - 0.04; /* m, travel beyond the bone's surface */
            if (way > 0.1e-3) assert_float_equal(-out.force[2] * compliance, way, 0.01 * way);
        }
        trocar_sim_free(sim);
        trocar_model_free(model);
    }
}

/* A tilted tip is pushed along its axis onto skin that it does not puncture. It slides as soon as the force leaves the friction cone; from then on, the
   force stays on the edge of the cone. */
static void a_leaning_tip_slides_at_the_cone_of_friction(void **state) {
    (void)state;
    static const double LEAN = 0.6; /* rad */
    for (double friction = 0.1; friction < 0.5; friction *= 2.0) {
        trocar_scene *scene = cube_scene(INFINITY);
        trocar_sim *sim;
        trocar_output out;
        OK(trocar_scene_set_number(scene, "contact.surface_friction", friction, &why));
        OK(trocar_scene_set(scene, "membranes[skin].puncture_force", "100", &why));
        OK(trocar_scene_set_number(scene, "needle.outer_diameter", 4e-3, &why));
        trocar_model *model = model_of(scene);
        OK(trocar_sim_create(model, &sim, &why));
        trocar_pose base = {{-0.201 * sin(LEAN), 0.0, -0.201 * cos(LEAN)}, {cos(LEAN / 2), 0, sin(LEAN / 2), 0}};
        OK(trocar_sim_reset(sim, 0, &base, &why));
        for (int t = 0; t < 600; t++) {
            base.position[0] += 1e-5 * sin(LEAN), base.position[2] += 1e-5 * cos(LEAN);
            OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
            if (t >= 450) assert_float_equal(out.force[0] / out.force[2], friction, 0.06 * friction); /* not exact, because the tip lags behind the hand */
        }
        trocar_sim_free(sim);
        trocar_model_free(model);
    }
}

static trocar_model *model_from(const char *name, const char *key, const char *value) {
    char path[512];
    trocar_scene *scene;
    snprintf(path, sizeof path, MESHES "/%s", name);
    OK(trocar_scene_load(path, &scene, &why));
    if (key) OK(trocar_scene_set(scene, key, value, &why));
    return model_of(scene);
}

/* Functions documented in trocar.h to fill at most `room` entries write nothing if `room` is 0. */
static void no_room_is_no_fault(void **state) {
    (void)state;
    trocar_model *model = model_from("template.yaml", NULL, NULL);
    trocar_sim *sim;
    trocar_output out;
    OK(trocar_sim_create(model, &sim, &why));
    trocar_pose base = {{0.005, 0.003, -0.24}, {1, 0, 0, 0}};
    OK(trocar_sim_reset(sim, 0, &base, &why));
    for (int t = 0; t < 400; t++, base.position[0] += t < 200 ? 0.0 : 1e-5, base.position[2] += 1e-4) OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    trocar_contact contacts[TROCAR_MAX_POINTS + 1];
    int count = trocar_view_contacts(trocar_sim_view(sim), 0, contacts, TROCAR_MAX_POINTS);
    assert_true(count >= 2 && contacts[0].kind == TROCAR_CONTACT_GUIDE);
    for (int room = -2; room <= count; room++) {
        trocar_contact some[TROCAR_MAX_POINTS + 1];
        memset(some, 0x5a, sizeof some);
        assert_int_equal(trocar_view_contacts(trocar_sim_view(sim), 0, some, room), count);
        int filled = room < 0 ? 0 : room;
        assert_memory_equal(some, contacts, (size_t)filled * sizeof *some);
        for (size_t i = (size_t)filled * sizeof *some; i < sizeof some; i++) assert_int_equal(((unsigned char *)some)[i], 0x5a);
        assert_true(trocar_view_tracks(trocar_sim_view(sim), 0, NULL, -1) >= 0 && trocar_view_pending_contacts(trocar_sim_view(sim), 0, NULL, -1) >= 0);
        assert_true(trocar_view_centreline(trocar_sim_view(sim), 0, NULL, -1) > 2 && trocar_view_seeds(trocar_sim_view(sim), NULL, -1) == 0);
    }
    trocar_sim_free(sim);
    trocar_model_free(model);
}

static void go(trocar_sim *sim, int needle, trocar_pose *base, double to) {
    const double step = 1e-4;
    trocar_output out;
    while (fabs(to - base->position[2]) > 1e-9) {
        base->position[2] += fmax(-step, fmin(step, to - base->position[2]));
        OK(trocar_sim_step(sim, needle, base, 1e-3, &out, &why));
    }
}

/* Returns the pose at which the second needle's base comes to rest in a track cut by needle `first`. */
static trocar_pose rest_in_track_of(trocar_model *model, int first) {
    const trocar_pose far = {{0.05, 0.05, -0.4}, {1, 0, 0, 0}};
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
    trocar_sim *sim;
    OK(trocar_sim_create(model, &sim, &why));
    for (int i = 0; i < 2; i++) OK(trocar_sim_reset(sim, i, i == first ? &base : &far, &why));
    go(sim, first, &base, -0.14);
    go(sim, first, &base, -0.202);
    if (first != 1) OK(trocar_sim_reset(sim, 1, &base, &why));
    go(sim, 1, &base, -0.16);
    go(sim, 1, &base, -0.163); /* drawn back, so that the needle springs forward on release */
    OK(trocar_sim_leave(sim, 1, &why));
    OK(trocar_sim_work(sim, NULL, &why));
    assert_int_equal(trocar_sim_needle_state(sim, 1), TROCAR_NEEDLE_RESTING);
    trocar_pose rest = trocar_view_base(trocar_sim_view(sim), 1);
    assert_true(rest.position[2] > base.position[2] + 1e-4);
    trocar_sim_free(sim);
    return rest;
}

/* A released needle comes to rest at the same pose in another needle's track as in its own, because tissue stays cut whichever needle cut it. */
static void a_needle_is_let_go_in_anothers_track_as_in_its_own(void **state) {
    (void)state;
    trocar_model *model = model_from("figure8.yaml", "needles", "2");
    trocar_pose own = rest_in_track_of(model, 1), others = rest_in_track_of(model, 0);
    for (int a = 0; a < 3; a++) assert_true(fabs(own.position[a] - others.position[a]) < 1e-9);
    trocar_model_free(model);
}

/* It also comes to rest at the same pose if the state is saved and restored between the release command and the worker's update. */
static void saved_before_it_is_let_go_it_comes_to_the_same(void **state) {
    (void)state;
    trocar_model *model = model_from("figure8.yaml", "needles", "2");
    const trocar_pose far = {{0.05, 0.05, -0.4}, {1, 0, 0, 0}};
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
    trocar_sim *sim, *second;
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_create(model, &second, &why));
    OK(trocar_sim_reset(sim, 0, &base, &why));
    OK(trocar_sim_reset(sim, 1, &far, &why));
    go(sim, 0, &base, -0.14);
    go(sim, 0, &base, -0.202);
    OK(trocar_sim_reset(sim, 1, &base, &why));
    go(sim, 1, &base, -0.16);
    go(sim, 1, &base, -0.163);
    OK(trocar_sim_leave(sim, 1, &why));
    size_t size = trocar_sim_state_size(sim);
    void *saved = malloc(size);
    OK(trocar_sim_save(sim, saved, size, &why));
    OK(trocar_sim_restore(second, saved, size, &why));
    OK(trocar_sim_work(sim, NULL, &why));
    OK(trocar_sim_work(second, NULL, &why));
    trocar_pose one = trocar_view_base(trocar_sim_view(sim), 1), other = trocar_view_base(trocar_sim_view(second), 1);
    assert_int_equal(trocar_sim_needle_state(second, 1), TROCAR_NEEDLE_RESTING);
    for (int a = 0; a < 3; a++) assert_true(fabs(one.position[a] - other.position[a]) < 1e-9);
    free(saved);
    trocar_sim_free(sim);
    trocar_sim_free(second);
    trocar_model_free(model);
}

/* Objects can be freed in any order, because whatever uses the model keeps it alive. */
static void the_model_goes_with_its_last_user(void **state) {
    (void)state;
    trocar_scene *scene;
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    trocar_model *model, *derived;
    trocar_sim *sim;
    trocar_picture *picture;
    trocar_output out;
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_model_derive(model, scene, &derived, &why));
    OK(trocar_sim_create(derived, &sim, &why));
    OK(trocar_picture_create(derived, &picture, &why));
    double *field = malloc(3 * (size_t)trocar_model_node_count(model) * sizeof *field);
    trocar_model_free(model);
    trocar_model_free(derived);
    trocar_scene_free(scene);
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
    OK(trocar_sim_reset(sim, 0, &base, &why));
    for (int t = 0; t < 100; t++, base.position[2] += 1e-4) OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    trocar_sim_take_picture(sim, picture);
    trocar_sim_free(sim);
    OK(trocar_view_displacements(trocar_picture_view(picture), field, &why));
    trocar_picture_free(picture);
    free(field);
}

static void a_copied_scene_is_one_of_its_own(void **state) {
    (void)state;
    trocar_scene *scene = cube_scene(INFINITY), *copied;
    OK(trocar_scene_copy(scene, &copied, &why));
    OK(trocar_scene_set_number(copied, "needle.length", 0.1, &why));
    double length;
    OK(trocar_scene_get_number(scene, "needle.length", &length, &why));
    assert_true(length == 0.2);
    trocar_scene_free(scene);
    trocar_model *model = model_of(copied);
    assert_int_equal(trocar_model_node_count(model), CUBE_NODES);
    assert_true(trocar_model_needle_length(model) == 0.1);
    trocar_model_free(model);
}

/* ---- threads ---------------------------------------------------------------------------------------------------------------- */

enum { THREADS = 4 };

static void *read_keys(void *context) {
    int *known = context;
    for (int i = 0; i < trocar_key_count(); i++) {
        trocar_key key = trocar_key_at(i);
        *known += key.key[0] && key.doc[0] && key.accepts[0] && (key.required || strcmp(key.key, "needle.length") != 0 || strcmp(key.default_value, "0.2") == 0);
    }
    return NULL;
}

/* Must run before all other tests, while no scene key has been looked up yet. Intended for ThreadSanitizer. */
static void the_table_of_keys_is_made_once(void **state) {
    (void)state;
    pthread_t thread[THREADS];
    int known[THREADS] = {0};
    for (int i = 0; i < THREADS; i++) assert_int_equal(pthread_create(&thread[i], NULL, read_keys, &known[i]), 0);
    for (int i = 0; i < THREADS; i++) pthread_join(thread[i], NULL);
    for (int i = 0; i < THREADS; i++) assert_int_equal(known[i], trocar_key_count());
    assert_string_equal(trocar_key_at(trocar_key_count()).key, "");
    assert_string_equal(trocar_key_at(-1).key, "");
}

typedef struct { trocar_sim *sim; double *field; trocar_status status; } field_seeker;

static void *look_at_field(void *context) {
    field_seeker *seeker = context;
    trocar_error reason;
    seeker->status = trocar_view_displacements(trocar_sim_view(seeker->sim), seeker->field, &reason);
    return NULL;
}

/* With a condensed inverse, the stiffness matrix is only assembled when the first displacement field is requested. Here this happens while other threads
   derive models from the same model. Intended for ThreadSanitizer. */
static void models_are_derived_beside_a_first_field(void **state) {
    (void)state;
    char cache[] = "/tmp/test_hosts.XXXXXX", command[64];
    assert_non_null(mkdtemp(cache));
    for (int round = 0; round < 3; round++) {
        trocar_scene *scene;
        OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
        OK(trocar_scene_set(scene, "inverse", "condensed", &why));
        /* the region of interest contains the needle, so no other call assembles the matrix */
        OK(trocar_scene_set(scene, "region_of_interest.corridor.from", "[0.005, 0.003, 0.0]", &why));
        OK(trocar_scene_set(scene, "region_of_interest.corridor.to", "[0.005, 0.003, 0.04]", &why));
        OK(trocar_scene_set(scene, "region_of_interest.corridor.radius", "0.03", &why));
        OK(trocar_scene_set(scene, "cache", cache, &why));
        trocar_model *model, *derived[20];
        trocar_sim *sim;
        trocar_output out;
        OK(trocar_model_create(scene, NULL, &model, &why));
        OK(trocar_sim_create(model, &sim, &why));
        trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
        OK(trocar_sim_reset(sim, 0, &base, &why));
        for (int t = 0; t < 60; t++, base.position[2] += 1e-4) OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
        pthread_t thread;
        field_seeker seeker = {.sim = sim, .field = malloc(3 * (size_t)trocar_model_node_count(model) * sizeof(double))};
        assert_int_equal(pthread_create(&thread, NULL, look_at_field, &seeker), 0);
        for (int i = 0; i < 20; i++) OK(trocar_model_derive(model, scene, &derived[i], &why));
        pthread_join(thread, NULL);
        assert_int_equal(seeker.status, TROCAR_OK);
        free(seeker.field);
        for (int i = 0; i < 20; i++) trocar_model_free(derived[i]);
        trocar_sim_free(sim);
        trocar_model_free(model);
        trocar_scene_free(scene);
    }
    snprintf(command, sizeof command, "rm -rf %s", cache);
    assert_int_equal(system(command), 0);
}

/* ---- long calls ------------------------------------------------------------------------------------------------------------------ */

enum { BATCH = 6, STEPS = 400 };

static void straight_in(trocar_pose poses[BATCH][STEPS]) {
    for (int i = 0; i < BATCH; i++)
        for (int t = 0; t < STEPS; t++) poses[i][t] = at(1e-3 * i, 2e-3, -1e-3 + 5e-5 * t);
}

typedef struct {
    pthread_t caller;
    int asked, most;         /* cancels then */
    double fraction;
    char what[16];
} watcher;

static void note_progress(const char *what, double fraction, void *context) {
    watcher *w = context;
    assert_true(pthread_equal(pthread_self(), w->caller));
    assert_true(fraction >= w->fraction && fraction <= 1.0);
    w->fraction = fraction;
    snprintf(w->what, sizeof w->what, "%s", what);
}

static int count_questions(void *context) {
    watcher *w = context;
    assert_true(pthread_equal(pthread_self(), w->caller));
    return ++w->asked > w->most;
}

static bool is_zero(const trocar_output *out) {
    static const trocar_output zero;
    return memcmp(out, &zero, sizeof zero) == 0;
}

/* Up to the tick in which an insertion was cancelled, its outputs equal those of the complete rollout. After that, they are zero. */
static void a_rollout_is_watched_and_cancelled(void **state) {
    (void)state;
    static trocar_pose poses[BATCH][STEPS];
    static trocar_output all[BATCH][STEPS], some[BATCH][STEPS];
    trocar_model *model = model_of(cube_scene(INFINITY));
    straight_in(poses);
    OK(trocar_rollout(model, poses[0], BATCH, STEPS, NULL, all[0], &why));
    for (int threads = 1; threads <= 3; threads += 2) {
        watcher w = {.caller = pthread_self(), .most = 1000000};
        const trocar_rollout_options options = {.dt = 1e-3, .threads = threads, .watch = {note_progress, count_questions, &w}};
        OK(trocar_rollout(model, poses[0], BATCH, STEPS, &options, some[0], &why));
        assert_memory_equal(some, all, sizeof all);
        assert_true(w.fraction == 1.0 && w.asked > (threads == 1 ? 2 : 0));
        assert_string_equal(w.what, "rollout");
        w = (watcher){.caller = pthread_self(), .most = threads == 1 ? 2 : 0};
        trocar_status status = trocar_rollout(model, poses[0], BATCH, STEPS, &options, some[0], &why);
        int left_out = 0;
        for (int i = 0; i < BATCH; i++) {
            int t = 0;
            while (t < STEPS && !is_zero(&some[i][t])) t++;
            assert_memory_equal(some[i], all[i], (size_t)t * sizeof *all[i]);
            left_out += STEPS - t;
            for (; t < STEPS; t++) assert_true(is_zero(&some[i][t]));
        }
        if (threads == 1) assert_true(left_out > STEPS);
        assert_int_equal(status, left_out > 0 ? TROCAR_CANCELLED : TROCAR_OK); /* the other threads may have finished before the cancellation */
    }
    trocar_model_free(model);
}

static void a_run_is_watched_and_cancelled(void **state) {
    (void)state;
    static trocar_pose poses[BATCH][STEPS];
    static trocar_output stepped[STEPS], run[STEPS];
    trocar_model *model = model_of(cube_scene(INFINITY));
    trocar_sim *sim;
    straight_in(poses);
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_reset(sim, 0, &poses[0][0], &why));
    for (int t = 0; t < STEPS; t++) OK(trocar_sim_step(sim, 0, &poses[0][t], 1e-3, &stepped[t], &why));
    OK(trocar_sim_reset(sim, 0, &poses[0][0], &why));
    watcher w = {.caller = pthread_self(), .most = 1000};
    const trocar_watch watch = {note_progress, count_questions, &w};
    OK(trocar_sim_run(sim, 0, poses[0], STEPS, 1e-3, &watch, run, &why));
    assert_memory_equal(run, stepped, sizeof run);
    assert_true(w.fraction == 1.0);
    OK(trocar_sim_reset(sim, 0, &poses[0][0], &why));
    w = (watcher){.caller = pthread_self(), .most = 1};
    assert_int_equal(trocar_sim_run(sim, 0, poses[0], STEPS, 1e-3, &watch, run, &why), TROCAR_CANCELLED);
    assert_non_null(strstr(why.text, "step 128"));
    assert_memory_equal(run, stepped, 128 * sizeof *run);
    for (int t = 128; t < STEPS; t++) assert_true(is_zero(&run[t]));
    poses[0][7].position[0] = NAN;
    OK(trocar_sim_reset(sim, 0, &poses[0][0], &why));
    assert_int_equal(trocar_sim_run(sim, 0, poses[0], STEPS, 1e-3, NULL, run, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "step 7: the pose is not finite"));
    assert_true(!is_zero(&run[6]) && is_zero(&run[7]));
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* With each kind of inverse, creating a model can be cancelled at any call of `cancelled`, and all its memory is freed. */
static void a_model_is_cancelled_at_any_question(void **state) {
    (void)state;
    static const char *const kinds[] = {"dense", "sparse", "condensed"};
    char cache[] = "/tmp/test_hosts.XXXXXX", command[64];
    assert_non_null(mkdtemp(cache));
    for (int kind = 0; kind < 3; kind++) {
        int asked = 0;
        for (int most = 0; most <= 1000; most++) {
            trocar_scene *scene;
            OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
            OK(trocar_scene_set(scene, "inverse", kinds[kind], &why));
            OK(trocar_scene_set(scene, "region_of_interest.regions", "[prostate]", &why));
            OK(trocar_scene_set(scene, "cache", cache, &why));
            watcher w = {.caller = pthread_self(), .most = most};
            trocar_model_options options = {.watch = {.cancelled = count_questions, .context = &w}};
            trocar_model *model;
            trocar_status status = trocar_model_create(scene, &options, &model, &why);
            trocar_scene_free(scene);
            asked = w.asked;
            if (status == TROCAR_OK) {
                trocar_model_free(model);
                break;
            }
            assert_int_equal(status, TROCAR_CANCELLED);
            assert_null(model);
            assert_int_equal(w.asked, most + 1);
            if (most > 8) most += 7; /* skips most of the roughly one hundred calls */
        }
        assert_true(asked >= (kind == 1 ? 3 : 5));
    }
    snprintf(command, sizeof command, "rm -rf %s", cache);
    assert_int_equal(system(command), 0);
}

/* ---- little memory ------------------------------------------------------------------------------------------------------------------ */

/* bytes */
static size_t mapped(void) {
    size_t pages = 0;
    FILE *file = fopen("/proc/self/statm", "r");
    if (!file || fscanf(file, "%zu", &pages) != 1) fail_msg("no /proc/self/statm");
    fclose(file);
    return pages * (size_t)sysconf(_SC_PAGESIZE);
}

static void limit(size_t bytes) {
    struct rlimit limits;
    getrlimit(RLIMIT_AS, &limits);
    limits.rlim_cur = bytes;
    setrlimit(RLIMIT_AS, &limits);
}

/* If there is only enough memory for fewer threads than requested, all insertions are still simulated. */
static void threads_without_memory_leave_the_work_to_others(void **state) {
    (void)state;
    if (SANITIZED) skip();
    static trocar_pose poses[BATCH][STEPS];
    static trocar_output all[BATCH][STEPS], some[BATCH][STEPS];
    const trocar_rollout_options two_threads = {.dt = 1e-3, .threads = 2};
    trocar_scene *scene = cube_scene(INFINITY);
    OK(trocar_scene_set(scene, "needles", "32", &why)); /* makes a simulation take about a hundred megabytes */
    trocar_model *model = model_of(scene);
    trocar_sim *sim;
    straight_in(poses);
    size_t before = mapped();
    OK(trocar_sim_create(model, &sim, &why));
    size_t one = mapped() - before;
    trocar_sim_free(sim);
    assert_true(one > 50000000);
    OK(trocar_rollout(model, poses[0], BATCH, STEPS, &two_threads, all[0], &why)); /* makes BLAS allocate its memory for two threads */
    int short_of_memory = 0;
    for (double room = 0.2; room < 4.0; room += 0.4) {
        limit(mapped() + (size_t)(room * (double)one));
        trocar_status status = trocar_rollout(model, poses[0], BATCH, STEPS, &two_threads, some[0], &why);
        limit(RLIM_INFINITY);
        if (status == TROCAR_OK) assert_memory_equal(some, all, sizeof all);
        else assert_int_equal(status, TROCAR_NO_MEMORY);
        if (status != TROCAR_OK)
            for (int i = 0; i < BATCH; i++) assert_true(is_zero(&some[i][0]));
        short_of_memory += status != TROCAR_OK;
        if (room > 2.0) assert_int_equal(status, TROCAR_OK); /* there is enough room for one simulation and its saved state */
    }
    assert_true(short_of_memory > 0);
    trocar_model_free(model);
}

/* Creates a model, a simulation and a snapshot in a new process running this program. The exit status is that of the first call that fails. */
static int live(void) {
    trocar_scene *scene;
    trocar_model *model = NULL;
    trocar_sim *sim = NULL;
    trocar_picture *picture = NULL;
    trocar_output out;
    trocar_status status = trocar_scene_load(MESHES "/figure8.yaml", &scene, &why);
    if (status == TROCAR_OK) status = trocar_model_create(scene, NULL, &model, &why);
    if (status == TROCAR_OK) status = trocar_sim_create(model, &sim, &why);
    if (status == TROCAR_OK) status = trocar_picture_create(model, &picture, &why);
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
    if (status == TROCAR_OK) status = trocar_sim_reset(sim, 0, &base, &why);
    for (int t = 0; t < 300 && status == TROCAR_OK; t++, base.position[2] += 1e-4) status = trocar_sim_step(sim, 0, &base, 1e-3, &out, &why);
    if (status != TROCAR_OK) fprintf(stderr, "%s\n", why.text);
    _exit((int)status);
}

/* Whatever the address-space limit, the status is OK or NO_MEMORY, and the process ends in time. */
static void too_little_address_space_is_told(void **state) {
    (void)state;
    if (SANITIZED) skip();
    int told = 0, done = 0;
    for (size_t room = 250; room <= 900; room += 25) { /* MB, of which the program and its libraries take about 180 */
        pid_t child = fork();
        if (child == 0) {
            setenv("OPENBLAS_NUM_THREADS", "2", 1);
            limit(room << 20);
            setenv("TROCAR_TEST_LIVE", "1", 1);
            execl("/proc/self/exe", "test_public", "test_hosts", (char *)NULL);
            _exit(99);
        }
        int status, seconds = 0;
        while (waitpid(child, &status, WNOHANG) == 0 && seconds++ < 600) usleep(100000);
        if (seconds >= 600) {
            kill(child, SIGKILL);
            waitpid(child, &status, 0);
            fail_msg("%zu MB: still running after a minute", room);
        }
        if (!WIFEXITED(status)) fail_msg("%zu MB: signal %d", room, WTERMSIG(status));
        if (WEXITSTATUS(status) != TROCAR_OK && WEXITSTATUS(status) != TROCAR_NO_MEMORY) fail_msg("%zu MB: status %d", room, WEXITSTATUS(status));
        told += WEXITSTATUS(status) == TROCAR_NO_MEMORY;
        done += WEXITSTATUS(status) == TROCAR_OK;
    }
    assert_true(told >= 5 && done >= 3);
}

int main(void) {
    if (getenv("TROCAR_TEST_LIVE")) return live();
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_table_of_keys_is_made_once),
        cmocka_unit_test(bone_is_no_membrane), cmocka_unit_test(bone_yields_as_its_key_says), cmocka_unit_test(a_leaning_tip_slides_at_the_cone_of_friction),
        cmocka_unit_test(no_room_is_no_fault),
        cmocka_unit_test(a_needle_is_let_go_in_anothers_track_as_in_its_own),
        cmocka_unit_test(saved_before_it_is_let_go_it_comes_to_the_same),
        cmocka_unit_test(the_model_goes_with_its_last_user),
        cmocka_unit_test(a_copied_scene_is_one_of_its_own),
        cmocka_unit_test(models_are_derived_beside_a_first_field),
        cmocka_unit_test(a_rollout_is_watched_and_cancelled),
        cmocka_unit_test(a_run_is_watched_and_cancelled),
        cmocka_unit_test(a_model_is_cancelled_at_any_question),
        cmocka_unit_test(threads_without_memory_leave_the_work_to_others),
        cmocka_unit_test(too_little_address_space_is_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
