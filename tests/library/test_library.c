/* libtrocar as its users see it: trocar.h and nothing else. */
#include <gmshc.h>
#include <math.h>
#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#if defined(__SSE2__)
#include <immintrin.h>
#endif

#include "cube_mesh.h"

#include <cmocka.h>

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

static void assert_refused(trocar_status status, const char *words) {
    assert_int_equal(status, TROCAR_BAD_INPUT);
    if (!strstr(why.text, words)) fail_msg("\"%s\" lacks \"%s\"", why.text, words);
}

/* ---- a scene by calls ---- */

static trocar_scene *cube_scene(void) {
    cube_mesh *cube = malloc(sizeof *cube);
    trocar_scene *scene;
    cube_create(cube);
    trocar_mesh arrays = cube_arrays(cube);
    OK(trocar_scene_create(&scene, &why));
    OK(trocar_scene_set_mesh(scene, &arrays, &why));
    free(cube); /* it was copied */
    OK(trocar_scene_set_number(scene, "regions[body].youngs_modulus", 20e3, &why));
    OK(trocar_scene_set(scene, "membranes[skin].puncture_force", "0.5", &why));
    OK(trocar_scene_set(scene, "fixed", "[back]", &why));
    OK(trocar_scene_set_number(scene, "needle.bevel_slope", 0.05, &why));
    return scene;
}

static trocar_model *model_of(trocar_scene *scene) {
    trocar_model *model;
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    return model;
}

enum { TICKS = 500 };

/* In at 50 mm/s, a little sideways, with a slow turn. */
static trocar_pose pose_at(int tick) {
    double turn = 1e-3 * tick;
    return (trocar_pose){{1e-3 + 1e-6 * tick, 2e-3, -0.2005 + 50e-6 * tick}, {cos(0.5 * turn), 0, 0, sin(0.5 * turn)}};
}

static trocar_sim *sim_at_start(trocar_model *model) {
    trocar_sim *sim;
    trocar_pose start = pose_at(0);
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_reset(sim, 0, &start, &why));
    return sim;
}

static void run(trocar_sim *sim, int from, int to, trocar_output *outputs) {
    for (int t = from; t < to; t++) {
        trocar_pose base = pose_at(t);
        OK(trocar_sim_step(sim, 0, &base, 1e-3, &outputs[t], &why));
    }
}

static void assert_same(const trocar_output *a, const trocar_output *b) { assert_memory_equal(a, b, TICKS * sizeof *a); }

static void a_mesh_from_arrays_is_that_of_the_file(void **state) {
    (void)state;
    char path[] = "/tmp/test_library.XXXXXX";
    int file = mkstemp(path);
    char named[sizeof path + 4];
    snprintf(named, sizeof named, "%s.msh", path);
    cube_mesh *cube = malloc(sizeof *cube);
    cube_create(cube);
    cube_write(cube, named);
    trocar_scene *from_file = cube_scene();
    OK(trocar_scene_set(from_file, "mesh", named, &why));
    trocar_model *arrays = model_of(cube_scene()), *read = model_of(from_file);
    assert_int_equal(trocar_model_node_count(arrays), CUBE_NODES);
    assert_memory_equal(trocar_model_nodes(arrays), cube->nodes, sizeof cube->nodes);
    assert_memory_equal(trocar_model_nodes(read), cube->nodes, sizeof cube->nodes);
    static trocar_output a[TICKS], b[TICKS];
    trocar_sim *first = sim_at_start(arrays), *second = sim_at_start(read);
    run(first, 0, TICKS, a);
    run(second, 0, TICKS, b);
    assert_true(a[TICKS - 1].contacts > 3 && fabs(a[TICKS - 1].force[2]) > 0.3);
    assert_same(a, b);
    trocar_sim_free(first);
    trocar_sim_free(second);
    trocar_model_free(arrays);
    trocar_model_free(read);
    free(cube);
    close(file);
    unlink(path);
    unlink(named);
}

static void keys_are_set_and_told(void **state) {
    (void)state;
    char text[64];
    double number;
    trocar_scene *scene = cube_scene();
    OK(trocar_scene_get_number(scene, "regions[0].youngs_modulus", &number, &why));
    assert_true(number == 20e3);
    OK(trocar_scene_get(scene, "regions[body].name", text, sizeof text, &why));
    assert_string_equal(text, "body");
    OK(trocar_scene_set(scene, "region_of_interest.corridor.from", "[0, -1e-3, .5]", &why));
    OK(trocar_scene_get(scene, "region_of_interest.corridor.from", text, sizeof text, &why));
    assert_string_equal(text, "[0, -0.001, 0.5]");
    OK(trocar_scene_set_number(scene, "device.max_stiffness", INFINITY, &why));
    OK(trocar_scene_get_number(scene, "device.max_stiffness", &number, &why));
    assert_true(isinf(number));
    assert_int_equal(trocar_scene_count(scene, "membranes"), 1);
    assert_int_equal(trocar_scene_count(scene, "needles"), -1);
    assert_refused(trocar_scene_set(scene, "needle.lenght", "0.1", &why), "needle.lenght");
    assert_refused(trocar_scene_set(scene, "needle.length", "long", &why), "\"long\": expected a number above 0 (m)");
    assert_refused(trocar_scene_set(scene, "regions[7].poisson_ratio", "0.4", &why), "regions[7].poisson_ratio");
    assert_refused(trocar_scene_set(scene, "fixed", "{a: b", &why), "not valid YAML");
    assert_refused(trocar_scene_get(scene, "needle.length", text, 2, &why), "2 bytes");
    OK(trocar_scene_get_number(scene, "needle.length", &number, &why));
    assert_true(number == 0.2);
    trocar_scene_free(scene);
}

/* Every key can be read back from a scene that has its default, and setting that changes nothing. */
static void the_table_of_keys_is_whole(void **state) {
    (void)state;
    trocar_scene *scene = cube_scene();
    assert_true(trocar_key_count() > 40);
    for (int i = 0; i < trocar_key_count(); i++) {
        trocar_key k = trocar_key_at(i);
        char key[128], before[256], after[256];
        const char *brackets = strstr(k.key, "[]");
        snprintf(key, sizeof key, "%.*s%s%s", (int)(brackets ? brackets - k.key : (long)strlen(k.key)), k.key, brackets ? "[0]" : "",
                 brackets ? brackets + 2 : "");
        assert_true(strlen(k.accepts) > 0 && strlen(k.doc) > 0);
        OK(trocar_scene_get(scene, key, before, sizeof before, &why));
        if (!k.required && k.standard[0]) {
            OK(trocar_scene_set(scene, key, k.standard, &why));
            OK(trocar_scene_get(scene, key, after, sizeof after, &why));
            assert_string_equal(after, k.standard);
        }
    }
    assert_string_equal(trocar_key_at(-1).key, "");
    assert_string_equal(trocar_key_at(trocar_key_count()).key, "");
    trocar_scene_free(scene);
}

static void bad_input_is_refused_in_words(void **state) {
    (void)state;
    trocar_scene *scene;
    trocar_model *model;
    assert_refused(trocar_scene_load("/nowhere/lost.yaml", &scene, &why), "/nowhere/lost.yaml");
    assert_null(scene);
    OK(trocar_scene_create(&scene, &why));
    assert_refused(trocar_model_create(scene, NULL, &model, &why), "missing key \"mesh\"");
    assert_null(model);
    cube_mesh *cube = malloc(sizeof *cube);
    cube_create(cube);
    trocar_mesh arrays = cube_arrays(cube);
    cube->tets[3][2] = CUBE_NODES;
    assert_refused(trocar_scene_set_mesh(scene, &arrays, &why), "tetrahedron 3 has node 216");
    cube->tets[3][2] = cube->tets[3][1];
    OK(trocar_scene_set_mesh(scene, &arrays, &why));
    OK(trocar_scene_set_number(scene, "regions[body].youngs_modulus", 20e3, &why));
    OK(trocar_scene_set(scene, "fixed", "[back]", &why));
    assert_refused(trocar_model_create(scene, NULL, &model, &why), "mesh");
    OK(trocar_scene_set(scene, "fixed", "[nothing]", &why));
    trocar_scene_free(scene);
    free(cube);

    model = model_of(cube_scene());
    trocar_sim *sim = sim_at_start(model);
    trocar_output out;
    trocar_pose base = pose_at(1), crooked = base, endless = base;
    crooked.orientation[0] = 2;
    endless.position[1] = NAN;
    assert_refused(trocar_sim_step(sim, 1, &base, 1e-3, &out, &why), "needle 1");
    assert_refused(trocar_sim_step(sim, 0, &crooked, 1e-3, &out, &why), "unit length");
    assert_refused(trocar_sim_step(sim, 0, &endless, 1e-3, &out, &why), "not finite");
    assert_refused(trocar_sim_step(sim, 0, &base, 0, &out, &why), "dt");
    assert_refused(trocar_sim_step(sim, 0, &base, NAN, &out, &why), "dt");
    assert_int_equal(trocar_sim_tick(sim, 0, &crooked, 1e-3, &out), TROCAR_BAD_INPUT);
    char small[8];
    assert_refused(trocar_sim_save(sim, small, sizeof small, &why), "8");
    assert_int_equal(trocar_scene_load("/nowhere", &scene, NULL), TROCAR_BAD_INPUT); /* without a place for the message */
    trocar_sim_free(sim);
    trocar_model_free(model);
    trocar_sim_free(NULL);
    trocar_model_free(NULL);
    trocar_scene_free(NULL);
}

/* ---- simulations ---- */

static void a_restored_state_goes_on_as_before(void **state) {
    (void)state;
    static trocar_output a[TICKS], b[TICKS];
    trocar_model *model = model_of(cube_scene());
    trocar_sim *sim = sim_at_start(model), *other = sim_at_start(model);
    size_t size = trocar_sim_state_size(sim);
    void *saved = malloc(size);
    run(sim, 0, TICKS / 2, a);
    OK(trocar_sim_save(sim, saved, size, &why));
    run(sim, TICKS / 2, TICKS, a);
    memcpy(b, a, sizeof a / 2);
    OK(trocar_sim_restore(other, saved, size, &why));
    run(other, TICKS / 2, TICKS, b);
    assert_same(a, b);
    OK(trocar_sim_restore(sim, saved, size, &why)); /* the one that went on goes back, too */
    run(sim, TICKS / 2, TICKS, b);
    assert_same(a, b);

    trocar_model *second = model_of(cube_scene());
    trocar_sim *stranger = sim_at_start(second);
    assert_refused(trocar_sim_restore(stranger, saved, size, &why), "another model");
    free(saved);
    trocar_sim_free(stranger);
    trocar_sim_free(other);
    trocar_sim_free(sim);
    trocar_model_free(second);
    trocar_model_free(model);
}

/* Tick and work in turn are what a step does. */
static void split_calls_agree_with_lockstep(void **state) {
    (void)state;
    static trocar_output a[TICKS], b[TICKS];
    trocar_model *model = model_of(cube_scene());
    trocar_sim *together = sim_at_start(model), *split = sim_at_start(model);
    run(together, 0, TICKS, a);
    for (int t = 0; t < TICKS; t++) {
        trocar_pose base = pose_at(t);
        assert_int_equal(trocar_sim_tick(split, 0, &base, 1e-3, &b[t]), TROCAR_OK);
        OK(trocar_sim_work(split, NULL, &why));
    }
    assert_same(a, b);
    trocar_sim_free(together);
    trocar_sim_free(split);
    trocar_model_free(model);
}

typedef struct {
    trocar_sim *sim;
    volatile bool stop;
    int served;
} worker;

static void *work(void *context) {
    worker *w = context;
    int more;
    while (!__atomic_load_n(&w->stop, __ATOMIC_ACQUIRE))
        if (trocar_sim_work(w->sim, &more, NULL) == TROCAR_OK && !more) usleep(50);
    return NULL;
}

/* With a worker that answers when it can, the forces are those of lockstep but for a tick or two. */
static void a_worker_thread_serves_the_tick(void **state) {
    (void)state;
    static trocar_output a[TICKS];
    trocar_model *model = model_of(cube_scene());
    trocar_sim *together = sim_at_start(model);
    worker w = {.sim = sim_at_start(model)};
    pthread_t thread;
    assert_int_equal(pthread_create(&thread, NULL, work, &w), 0);
    run(together, 0, TICKS, a);
    trocar_output out = {0};
    for (int t = 0; t < TICKS; t++) {
        trocar_pose base = pose_at(t);
        assert_int_equal(trocar_sim_tick(w.sim, 0, &base, 1e-3, &out), TROCAR_OK);
        usleep(500);
    }
    __atomic_store_n(&w.stop, true, __ATOMIC_RELEASE);
    pthread_join(thread, NULL);
    assert_int_equal(out.contacts, a[TICKS - 1].contacts);
    assert_true(fabs(out.force[2] - a[TICKS - 1].force[2]) < 0.05 * fabs(a[TICKS - 1].force[2]));
    trocar_sim_free(w.sim);
    trocar_sim_free(together);
    trocar_model_free(model);
}

/* Contacts, centreline and displacements belong to the force: the forces on the tissue and that on the hand cancel. */
static void what_is_seen_fits_the_force(void **state) {
    (void)state;
    static trocar_output a[TICKS];
    static trocar_contact contacts[TROCAR_MAX_CONTACTS + 1];
    static double joints[TROCAR_MAX_JOINTS][3], field[CUBE_NODES][3];
    trocar_model *model = model_of(cube_scene());
    trocar_sim *sim = sim_at_start(model);
    run(sim, 0, TICKS, a);
    int count = trocar_sim_contacts(sim, 0, contacts, TROCAR_MAX_CONTACTS + 1), joint_count = trocar_sim_centreline(sim, 0, joints[0], TROCAR_MAX_JOINTS);
    assert_int_equal(count, a[TICKS - 1].contacts + 1);
    assert_int_equal(contacts[count - 1].kind, TROCAR_CONTACT_TIP);
    assert_int_equal(joint_count, trocar_model_segments(model) + 1);
    double sum[3] = {0}, greatest = 0;
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) sum[k] += contacts[i].force[k];
    for (int k = 0; k < 3; k++) assert_true(fabs(sum[k] + a[TICKS - 1].force[k]) < 1e-9);
    for (int k = 0; k < 3; k++) assert_true(fabs(joints[joint_count - 1][k] - contacts[count - 1].position[k]) < 1e-12);
    OK(trocar_sim_displacements(sim, field[0], &why));
    for (int i = 0; i < CUBE_NODES; i++) greatest = fmax(greatest, fabs(field[i][2]));
    assert_true(greatest > 1e-5 && greatest < 0.01);
    for (int i = 0; i < CUBE_NODES; i++)
        if (trocar_model_nodes(model)[3 * i + 2] > 0.0399) assert_true(field[i][2] == 0.0);
    assert_true(trocar_sim_needle_energy(sim, 0) > 0.0);
    assert_int_equal(trocar_sim_contacts(sim, 0, contacts, 1), count);
    assert_int_equal(trocar_sim_contacts(sim, 1, contacts, 1), 0);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

static void a_rollout_does_not_depend_on_threads(void **state) {
    (void)state;
    enum { BATCH = 6 };
    static trocar_pose poses[BATCH][TICKS];
    static trocar_output one[BATCH][TICKS], two[BATCH][TICKS], single[TICKS];
    trocar_model *model = model_of(cube_scene());
    for (int b = 0; b < BATCH; b++)
        for (int t = 0; t < TICKS; t++) {
            poses[b][t] = pose_at(t);
            poses[b][t].position[0] += 1e-3 * b;
        }
    OK(trocar_rollout(model, poses[0], BATCH, TICKS, 1e-3, 1, one[0], &why));
    OK(trocar_rollout(model, poses[0], BATCH, TICKS, 1e-3, 3, two[0], &why));
    for (int b = 0; b < BATCH; b++) assert_same(one[b], two[b]);
    trocar_sim *sim = sim_at_start(model);
    run(sim, 0, TICKS, single);
    assert_same(single, one[0]);
    poses[2][100].orientation[0] = 7;
    assert_refused(trocar_rollout(model, poses[0], BATCH, TICKS, 1e-3, 2, two[0], &why), "insertion 2, step 100");
    assert_same(one[3], two[3]); /* the others are finished */
    assert_memory_equal(one[2], two[2], 100 * sizeof(trocar_output));
    assert_true(two[2][100].force[2] == 0.0 && two[2][TICKS - 1].depth == 0.0);
    assert_refused(trocar_rollout(model, poses[0], BATCH, TICKS, 1e-3, 0, two[0], &why), "threads");
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* ---- the host ---- */

static void a_host_keeps_its_gmsh_session_and_its_floating_point(void **state) {
    (void)state;
    int error = 0;
    char *current = NULL, path[] = "/tmp/test_host.XXXXXX", named[32];
    int file = mkstemp(path);
    snprintf(named, sizeof named, "%s.msh", path);
    cube_mesh *cube = malloc(sizeof *cube);
    cube_create(cube);
    cube_write(cube, named);
    free(cube);
    trocar_scene *scene = cube_scene();
    OK(trocar_scene_set(scene, "mesh", named, &why));
    gmshInitialize(0, NULL, 0, &error);
    gmshModelAdd("host", &error);
    gmshModelGeoAddPoint(1, 2, 3, 0, 7, &error);
    gmshModelGeoSynchronize(&error);
#if defined(__SSE2__)
    unsigned before = _mm_getcsr();
#endif
    static trocar_output a[TICKS];
    trocar_model *model = model_of(scene);
    trocar_sim *sim = sim_at_start(model);
    run(sim, 0, 10, a);
#if defined(__SSE2__)
    assert_int_equal(_mm_getcsr() & ~0x3fu, before & ~0x3fu); /* but for the sticky exception flags */
#endif
    gmshModelGetCurrent(&current, &error);
    assert_int_equal(error, 0);
    assert_string_equal(current, "host");
    int *entities;
    size_t count;
    gmshModelGetEntities(&entities, &count, 0, &error);
    assert_int_equal(error, 0);
    assert_int_equal(count, 2); /* one pair */
    gmshFree(entities);
    gmshFree(current);
    gmshFinalize(&error);
    trocar_sim_free(sim);
    trocar_model_free(model);
    close(file);
    unlink(path);
    unlink(named);
}

static void the_version_is_that_of_the_header(void **state) {
    (void)state;
    assert_int_equal(trocar_version(), TROCAR_NUMBER);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_mesh_from_arrays_is_that_of_the_file), cmocka_unit_test(keys_are_set_and_told),
        cmocka_unit_test(the_table_of_keys_is_whole), cmocka_unit_test(bad_input_is_refused_in_words),
        cmocka_unit_test(a_restored_state_goes_on_as_before), cmocka_unit_test(split_calls_agree_with_lockstep),
        cmocka_unit_test(a_worker_thread_serves_the_tick), cmocka_unit_test(what_is_seen_fits_the_force),
        cmocka_unit_test(a_rollout_does_not_depend_on_threads), cmocka_unit_test(a_host_keeps_its_gmsh_session_and_its_floating_point),
        cmocka_unit_test(the_version_is_that_of_the_header),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
