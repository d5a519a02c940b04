/* Tests libtrocar through its public header, trocar.h, alone. */
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
#include "needle_line.h"

#include <cmocka.h>

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

static void assert_refused(trocar_status status, const char *words) {
    assert_int_equal(status, TROCAR_BAD_INPUT);
    if (!strstr(why.text, words)) fail_msg("\"%s\" lacks \"%s\"", why.text, words);
}

/* ---- a scene built by calls ---- */

static trocar_scene *cube_scene(void) {
    cube_mesh *cube = malloc(sizeof *cube);
    trocar_scene *scene;
    cube_create(cube);
    trocar_mesh arrays = cube_arrays(cube);
    OK(trocar_scene_create(&scene, &why));
    OK(trocar_scene_set_mesh(scene, &arrays, &why));
    free(cube); /* the scene keeps its own copy */
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

/* Returns the base's pose during an insertion at 50 mm/s with a slow sideways motion and a slow rotation. */
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

/* Every key's default can be read from a scene, and setting a key to its default changes nothing. */
static void the_table_of_keys_is_whole(void **state) {
    (void)state;
    trocar_scene *scene = cube_scene();
    OK(trocar_scene_set(scene, "relaxation[0].weight", "0.5", &why));
    OK(trocar_scene_set(scene, "relaxation[0].time", "2", &why));
    assert_true(trocar_key_count() > 40);
    OK(trocar_scene_set(scene, "guides[plate].rows", "1", &why));
    OK(trocar_scene_set(scene, "calcifications[0].radius", "2e-3", &why));
    OK(trocar_scene_set(scene, "sliding[skin].shear_stiffness", "0", &why));
    for (int i = 0; i < trocar_key_count(); i++) {
        trocar_key k = trocar_key_at(i);
        char key[128], before[256], after[256];
        const char *brackets = strstr(k.key, "[]");
        snprintf(key, sizeof key, "%.*s%s%s", (int)(brackets ? brackets - k.key : (long)strlen(k.key)), k.key, brackets ? "[0]" : "",
                 brackets ? brackets + 2 : "");
        assert_true(strlen(k.accepts) > 0 && strlen(k.doc) > 0);
        OK(trocar_scene_get(scene, key, before, sizeof before, &why));
        if (!k.required && k.default_value[0]) {
            OK(trocar_scene_set(scene, key, k.default_value, &why));
            OK(trocar_scene_get(scene, key, after, sizeof after, &why));
            assert_string_equal(after, k.default_value);
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
    assert_int_equal(trocar_scene_load("/nowhere", &scene, NULL), TROCAR_BAD_INPUT); /* without a message buffer */
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
    OK(trocar_sim_restore(sim, saved, size, &why)); /* restores the state into the same simulation, which has moved on in the meantime */
    run(sim, TICKS / 2, TICKS, b);
    assert_same(a, b);

    trocar_scene *softer = cube_scene();
    OK(trocar_scene_set_number(softer, "regions[body].youngs_modulus", 19e3, &why));
    trocar_model *second = model_of(softer);
    trocar_sim *stranger = sim_at_start(second);
    assert_refused(trocar_sim_restore(stranger, saved, size, &why), "another model");
    free(saved);
    trocar_sim_free(stranger);
    trocar_sim_free(other);
    trocar_sim_free(sim);
    trocar_model_free(second);
    trocar_model_free(model);
}

/* A step does the same as a tick followed by work. */
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
    int rounds; /* rounds of work after which no request was pending */
} worker;

static void *work(void *context) {
    worker *w = context;
    trocar_work done;
    while (!__atomic_load_n(&w->stop, __ATOMIC_ACQUIRE))
        if (trocar_sim_work(w->sim, &done, NULL) == TROCAR_OK && !done.more) {
            __atomic_fetch_add(&w->rounds, 1, __ATOMIC_RELEASE);
            usleep(50);
        }
    return NULL;
}

static pthread_t start_worker(worker *w) {
    pthread_t thread;
    assert_int_equal(pthread_create(&thread, NULL, work, w), 0);
    return thread;
}

static void end_worker(worker *w, pthread_t thread) {
    __atomic_store_n(&w->stop, true, __ATOMIC_RELEASE);
    pthread_join(thread, NULL);
}

/* Computes a tick and then waits for a full round of work, so that the result does not depend on the machine's speed. Waits for two rounds to complete,
   because only the second is certain to have begun after the tick. */
static void tick_and_wait(worker *w, int tick, trocar_output *out) {
    trocar_pose base = pose_at(tick);
    assert_int_equal(trocar_sim_tick(w->sim, 0, &base, 1e-3, out), TROCAR_OK);
    for (int seen = __atomic_load_n(&w->rounds, __ATOMIC_ACQUIRE); __atomic_load_n(&w->rounds, __ATOMIC_ACQUIRE) - seen < 2;) usleep(50);
}

/* With an asynchronous worker, forces agree with those in lockstep except for a delay of one or two ticks. */
static void a_worker_thread_serves_the_tick(void **state) {
    (void)state;
    static trocar_output a[TICKS];
    trocar_model *model = model_of(cube_scene());
    trocar_sim *together = sim_at_start(model);
    worker w = {.sim = sim_at_start(model)};
    pthread_t thread = start_worker(&w);
    run(together, 0, TICKS, a);
    trocar_output out = {0};
    for (int t = 0; t < TICKS; t++) tick_and_wait(&w, t, &out);
    end_worker(&w, thread);
    assert_int_equal(out.contacts, a[TICKS - 1].contacts);
    assert_true(fabs(out.force[2] - a[TICKS - 1].force[2]) < 0.05 * fabs(a[TICKS - 1].force[2]));
    trocar_sim_free(w.sim);
    trocar_sim_free(together);
    trocar_model_free(model);
}

static trocar_change *other_modulus(const trocar_sim *sim) {
    trocar_change *change;
    OK(trocar_change_create(sim, &change, &why));
    OK(trocar_change_set(change, "regions[body].youngs_modulus: 100e3", &why));
    OK(trocar_change_prepare(change, NULL, &why));
    return change;
}

/* The same holds while moduli change: the ticking thread starts and ends the change, and the worker interpolates the compliances in between. */
static void moduli_change_beside_a_worker_thread(void **state) {
    (void)state;
    static trocar_output a[TICKS], unchanged[TICKS];
    trocar_model *model = model_of(cube_scene());
    trocar_sim *plain = sim_at_start(model), *together = sim_at_start(model);
    worker w = {.sim = sim_at_start(model)};
    trocar_change *change = other_modulus(together), *change_beside = other_modulus(w.sim);
    run(plain, 0, TICKS, unchanged);
    run(together, 0, TICKS / 2, a);
    OK(trocar_sim_change(together, change, TROCAR_CHANGE_TIME_LEAST, &why));
    run(together, TICKS / 2, TICKS, a);
    pthread_t thread = start_worker(&w);
    trocar_output out = {0};
    for (int t = 0; t < TICKS; t++) {
        if (t == TICKS / 2) OK(trocar_sim_change(w.sim, change_beside, TROCAR_CHANGE_TIME_LEAST, &why));
        tick_and_wait(&w, t, &out);
    }
    end_worker(&w, thread);
    double force = out.force[2], in_lockstep = a[TICKS - 1].force[2], before = unchanged[TICKS - 1].force[2];
    printf("force %.4f N; in lockstep %.4f N; without the change %.4f N\n", force, in_lockstep, before);
    assert_true(trocar_sim_changing(together) == 0.0 && trocar_sim_changing(w.sim) == 0.0);
    assert_int_equal(out.contacts, a[TICKS - 1].contacts);
    assert_true(fabs(force - in_lockstep) < 0.05 * fabs(in_lockstep) && fabs(in_lockstep - before) > 0.1 * fabs(before));
    trocar_change_free(change);
    trocar_change_free(change_beside);
    trocar_sim_free(w.sim);
    trocar_sim_free(together);
    trocar_sim_free(plain);
    trocar_model_free(model);
}

/* Contacts, centreline and displacements are consistent with the force, and the forces on tissue and hand add up to zero. */
static void what_is_seen_fits_the_force(void **state) {
    (void)state;
    static trocar_output a[TICKS];
    static trocar_contact contacts[TROCAR_MAX_POINTS];
    static double joints[TROCAR_MAX_JOINTS][3], field[CUBE_NODES][3];
    trocar_model *model = model_of(cube_scene());
    trocar_sim *sim = sim_at_start(model);
    run(sim, 0, TICKS, a);
    const trocar_view *view = trocar_sim_view(sim);
    int count = trocar_view_contacts(view, 0, contacts, TROCAR_MAX_POINTS), joint_count = trocar_view_centreline(view, 0, joints[0], TROCAR_MAX_JOINTS);
    assert_int_equal(count, a[TICKS - 1].contacts + 1);
    assert_int_equal(contacts[count - 1].kind, TROCAR_CONTACT_TIP);
    assert_int_equal(joint_count, trocar_model_segments(model) + 1);
    double sum[3] = {0}, greatest = 0;
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) sum[k] += contacts[i].force[k];
    for (int k = 0; k < 3; k++) assert_true(fabs(sum[k] + a[TICKS - 1].force[k]) < 1e-9);
    for (int i = 0; i < count; i++) assert_true(distance_from_needle((const double (*)[3])joints, joint_count, contacts[i].arc, contacts[i].position) < 1e-5);
    assert_true(contacts[count - 1].arc <= trocar_model_needle_length(model) && contacts[count - 1].arc > contacts[count - 2].arc);
    OK(trocar_view_displacements(trocar_sim_view(sim), field[0], &why));
    for (int i = 0; i < CUBE_NODES; i++) greatest = fmax(greatest, fabs(field[i][2]));
    assert_true(greatest > 1e-5 && greatest < 0.01);
    for (int i = 0; i < CUBE_NODES; i++)
        if (trocar_model_nodes(model)[3 * i + 2] > 0.0399) assert_true(field[i][2] == 0.0);
    assert_true(trocar_view_needle_energy(trocar_sim_view(sim), 0) > 0.0);
    assert_true(fabs(trocar_view_tip_lead(trocar_sim_view(sim), 0)) < 0.01); /* tilted, not turned */
    assert_true(trocar_view_tip_lead(trocar_sim_view(sim), 1) == 0.0);       /* there is none */
    assert_int_equal(trocar_view_contacts(trocar_sim_view(sim), 0, contacts, 1), count);
    assert_int_equal(trocar_view_contacts(trocar_sim_view(sim), 1, contacts, 1), 0);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* A snapshot taken in another thread does not change while the simulation continues. */
static void a_picture_keeps_what_was_seen(void **state) {
    (void)state;
    enum { ROOM = TROCAR_MAX_POINTS, MIDWAY = 4 * TICKS / 5 };
    static trocar_output a[TICKS];
    static trocar_contact seen[ROOM], kept[ROOM];
    static double joints[2][TROCAR_MAX_JOINTS][3], field[2][CUBE_NODES][3];
    trocar_model *model = model_of(cube_scene());
    trocar_sim *sim = sim_at_start(model);
    trocar_picture *picture, *copy;
    OK(trocar_picture_create(model, &picture, &why));
    OK(trocar_picture_create(model, &copy, &why));
    assert_int_equal(trocar_view_contacts(trocar_picture_view(picture), 0, kept, ROOM), 0);
    run(sim, 0, MIDWAY, a);
    trocar_sim_take_picture(sim, picture);
    const trocar_view *view = trocar_sim_view(sim);
    int count = trocar_view_contacts(view, 0, seen, ROOM), joint_count = trocar_view_centreline(view, 0, joints[0][0], TROCAR_MAX_JOINTS);
    trocar_pose base = trocar_view_base(view, 0), given = pose_at(MIDWAY - 1), in_picture;
    OK(trocar_view_displacements(trocar_sim_view(sim), field[0][0], &why));
    run(sim, MIDWAY, TICKS, a);
    trocar_picture_copy(picture, copy);
    assert_true(count >= 2); /* at least the tip and one more contact */
    assert_int_equal(trocar_view_contacts(trocar_picture_view(copy), 0, kept, ROOM), count);
    assert_memory_equal(kept, seen, (size_t)count * sizeof *seen);
    assert_int_equal(trocar_view_centreline(trocar_picture_view(copy), 0, joints[1][0], TROCAR_MAX_JOINTS), joint_count);
    assert_memory_equal(joints[1], joints[0], (size_t)joint_count * sizeof joints[0][0]);
    in_picture = trocar_view_base(trocar_picture_view(copy), 0);
    assert_memory_equal(&in_picture, &base, sizeof base);
    assert_memory_equal(base.position, given.position, sizeof given.position);
    OK(trocar_view_displacements(trocar_picture_view(copy), field[1][0], &why));
    assert_memory_equal(field[1], field[0], sizeof field[0]);
    assert_int_equal(trocar_view_contacts(trocar_picture_view(copy), 1, kept, ROOM), 0);
    trocar_picture_free(picture);
    trocar_picture_free(copy);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* The refined mesh fills the body. Its nodal forces are those of the contacts and of the damper at the tip. */
static void the_refined_mesh_carries_the_contacts(void **state) {
    (void)state;
    static trocar_output a[TICKS];
    trocar_model *model = model_of(cube_scene());
    trocar_sim *sim = sim_at_start(model);
    trocar_picture *picture;
    trocar_refined_mesh mesh = {0};
    OK(trocar_picture_create(model, &picture, &why));
    run(sim, 0, TICKS, a);
    trocar_sim_take_picture(sim, picture);
    for (int again = 0; again < 2; again++) OK(trocar_picture_refined_mesh(picture, &mesh, &why));
    assert_int_equal(mesh.node_count, CUBE_NODES + a[TICKS - 1].contacts);
    assert_true(mesh.tet_count > trocar_model_tet_count(model));
    assert_memory_equal(mesh.nodes, trocar_model_nodes(model), sizeof(double[CUBE_NODES][3]));
    double volume = 0, whole = 0, sum[3] = {0}, held = 0;
    for (int t = 0; t < mesh.tet_count + trocar_model_tet_count(model); t++) {
        const int32_t *c = t < mesh.tet_count ? mesh.tets + 4 * t : trocar_model_tets(model) + 4 * (t - mesh.tet_count);
        double e[3][3];
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) e[i][k] = mesh.nodes[3 * c[i + 1] + k] - mesh.nodes[3 * c[0] + k];
        double six = e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) - e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0])
                   + e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0]);
        if (t < mesh.tet_count) assert_true(six > 0 && mesh.parents[t] < trocar_model_tet_count(model));
        *(t < mesh.tet_count ? &volume : &whole) += six / 6;
    }
    assert_true(fabs(volume - whole) < 1e-12 * whole);
    for (int i = 0; i < mesh.node_count; i++)
        for (int k = 0; k < 3; k++) sum[k] += mesh.forces[3 * i + k];
    for (int k = 0; k < 3; k++) assert_true(fabs(sum[k] + a[TICKS - 1].force[k] - mesh.damping[k]) < 1e-9);
    for (int i = 0; i < CUBE_NODES; i++)
        if (trocar_model_fixed(model)[i]) held = fmax(held, fabs(mesh.displacements[3 * i + 2]));
    assert_true(held == 0.0);
    trocar_picture_free(picture);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

static int64_t made_time;
static int64_t made_clock(void) { return made_time; }

/* While no worker runs, the oldest request keeps ageing. Once it has been answered, none is pending. */
static void waiting_and_latency_are_told(void **state) {
    (void)state;
    trocar_model *model = model_of(cube_scene());
    trocar_sim *sim = sim_at_start(model);
    trocar_output out;
    trocar_work done;
    trocar_sim_set_clock(sim, made_clock);
    for (int t = 0; t < TICKS; t++) {
        trocar_pose base = pose_at(t);
        made_time = 1000000 * t;
        assert_int_equal(trocar_sim_tick(sim, 0, &base, 1e-3, &out), TROCAR_OK);
        assert_int_equal(trocar_sim_waiting(sim), made_time);
    }
    made_time += 7000000;
    OK(trocar_sim_work(sim, &done, &why));
    assert_true(done.answered == 1 && done.latency >= 7000000 && done.latency <= made_time);
    trocar_pose base = pose_at(TICKS - 1);
    for (int i = 0; i < 5; i++) { /* until no request is left */
        assert_int_equal(trocar_sim_tick(sim, 0, &base, 1e-3, &out), TROCAR_OK);
        OK(trocar_sim_work(sim, &done, &why));
    }
    assert_int_equal(trocar_sim_tick(sim, 0, &base, 1e-3, &out), TROCAR_OK);
    OK(trocar_sim_work(sim, &done, &why));
    assert_true(done.answered == 0 && done.latency == 0);
    assert_int_equal(trocar_sim_waiting(sim), 0);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* A base on a spring gives way by the force times the compliance, so the force is lower than with a rigid base. */
static void a_base_on_a_spring_yields(void **state) {
    (void)state;
    static trocar_output rigid[TICKS], soft[TICKS];
    trocar_model *model = model_of(cube_scene());
    trocar_sim *sim = sim_at_start(model);
    run(sim, 0, TICKS, rigid);
    trocar_pose start = pose_at(0), given = pose_at(TICKS - 1);
    trocar_sim_set_base_compliance(sim, 0, 2e-3);
    OK(trocar_sim_reset(sim, 0, &start, &why)); /* a reset keeps the spring */
    run(sim, 0, TICKS, soft);
    trocar_pose base = trocar_view_base(trocar_sim_view(sim), 0);
    const double *force = soft[TICKS - 1].force;
    for (int k = 0; k < 3; k++) assert_true(fabs(base.position[k] - given.position[k] - 2e-3 * force[k]) < 1e-6);
    assert_true(force[2] < -0.1 && base.position[2] < given.position[2] - 1e-4 && fabs(force[2]) < fabs(rigid[TICKS - 1].force[2]));
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* A model created with mesh_only, as viewers do, provides the mesh and the names but refuses calls that need the stiffness. */
static void a_model_may_be_its_mesh_alone(void **state) {
    (void)state;
    trocar_scene *scene = cube_scene();
    trocar_model_options options = {.mesh_only = 1};
    trocar_model *model, *whole = model_of(cube_scene());
    trocar_sim *sim;
    trocar_picture *picture;
    OK(trocar_model_create(scene, &options, &model, &why));
    assert_string_equal(trocar_model_inverse(model), "");
    assert_null(trocar_model_fixed(model));
    assert_refused(trocar_sim_create(model, &sim, &why), "mesh_only");
    assert_refused(trocar_picture_create(model, &picture, &why), "mesh_only");
    OK(trocar_model_prepare(model, &why));
    int body = trocar_model_find_region(model, "body", 3), skin = trocar_model_find_region(model, "skin", 2);
    assert_true(body >= 0 && skin >= 0 && trocar_model_find_region(model, "skin", 3) == -1);
    assert_true(trocar_model_part_of(model, body) == body && trocar_model_part_of(model, -1) == -1 && trocar_model_part_of(model, 32) == -1);
    assert_string_equal(trocar_model_region_name(model, skin), "skin");
    assert_int_equal(trocar_model_region_dimension(model, body), 3);
    assert_int_equal(trocar_model_region_dimension(model, 99), -1);
    assert_true(trocar_model_material(model, body).youngs_modulus == 20e3 && trocar_model_material(model, skin).youngs_modulus == 0);
    assert_int_equal(trocar_model_averages_strain(model), 0);
    int tets = trocar_model_tet_count(model);
    assert_null(trocar_model_strain_patches(model));
    for (int i = 0; i < tets; i++) assert_in_range(trocar_model_strain_patches(whole)[i], 0, tets - 1);
    for (int i = 0; i < 4 * tets; i++) { /* adjacency is mutual; a face on the skin has no neighbour */
        int neighbour = trocar_model_neighbours(model)[i], mutual = 0;
        for (int f = 0; neighbour >= 0 && f < 4; f++) mutual += trocar_model_neighbours(model)[4 * neighbour + f] == i / 4;
        assert_int_equal(mutual, neighbour >= 0);
        if (trocar_model_face_surfaces(model)[i] >> skin & 1) assert_int_equal(neighbour, -1);
    }
    double point[3], low[3] = {1e-3, 2e-3, -1}, high[3] = {1e-3, 2e-3, 1}, aside[3] = {1, 2e-3, 1}, far[3] = {1, 2e-3, -1};
    assert_int_equal(trocar_model_entry(model, low, high, point), 1);
    assert_true(fabs(point[2]) < 1e-12 && fabs(point[0] - 1e-3) < 1e-12);
    assert_int_equal(trocar_model_entry(model, far, aside, point), 0);
    int held = 0;
    for (int i = 0; i < CUBE_NODES; i++) held += trocar_model_fixed(whole)[i];
    assert_true(held > 0);
    assert_int_equal(trocar_model_unknowns(whole), 3 * (CUBE_NODES - held));
    assert_string_equal(trocar_model_remarks(whole), "");
    trocar_scene_free(scene);
    trocar_model_free(model);
    trocar_model_free(whole);
}

static void the_device_is_that_of_the_scene(void **state) {
    (void)state;
    trocar_scene *scene = cube_scene();
    trocar_device_limits unknown = trocar_scene_device(scene);
    assert_true(unknown.max_stiffness == 400.0 && unknown.mass == 0.1 && unknown.delay == 2e-3);
    assert_string_equal(trocar_scene_path(scene), "");
    OK(trocar_scene_set(scene, "device.profile", "touch", &why));
    OK(trocar_scene_set_number(scene, "device.ramp_time", 0.25, &why));
    trocar_device_limits limits = trocar_scene_device(scene);
    assert_true(limits.max_stiffness == 400.0 && limits.max_force == 3.3 && limits.ramp_time == 0.25);
    OK(trocar_scene_set_number(scene, "device.scale", 2, &why));
    OK(trocar_scene_set_number(scene, "device.force_scale", 0.25, &why));
    limits = trocar_scene_device(scene); /* limits at the needle: the hand moves half as far as the needle and feels a quarter of its force */
    assert_true(limits.max_force == 3.3 / 0.25 && limits.mass == 0.1 / 0.5 && limits.max_stiffness == 400 / 0.5 && limits.max_speed == 4);
    OK(trocar_scene_set_number(scene, "rate_hz", TROCAR_MAX_RATE, &why));
    assert_refused(trocar_scene_set_number(scene, "rate_hz", TROCAR_MAX_RATE + 1, &why), "rate_hz");
    assert_refused(trocar_scene_set_number(scene, "rate_hz", TROCAR_MIN_RATE - 1, &why), "rate_hz");
    trocar_scene_free(scene);
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
    OK(trocar_rollout(model, poses[0], BATCH, TICKS, NULL, one[0], &why));
    OK(trocar_rollout(model, poses[0], BATCH, TICKS, &(trocar_rollout_options){.dt = 1e-3, .threads = 3}, two[0], &why));
    for (int b = 0; b < BATCH; b++) assert_same(one[b], two[b]);
    trocar_sim *sim = sim_at_start(model);
    run(sim, 0, TICKS, single);
    assert_same(single, one[0]);
    poses[2][100].orientation[0] = 7;
    assert_refused(trocar_rollout(model, poses[0], BATCH, TICKS, &(trocar_rollout_options){.dt = 1e-3, .threads = 2}, two[0], &why), "insertion 2, step 100");
    assert_same(one[3], two[3]); /* the other insertions were completed */
    assert_memory_equal(one[2], two[2], 100 * sizeof(trocar_output));
    assert_true(two[2][100].force[2] == 0.0 && two[2][TICKS - 1].depth == 0.0);
    assert_refused(trocar_rollout(model, poses[0], BATCH, TICKS, &(trocar_rollout_options){.dt = 1e-3, .threads = 0}, two[0], &why), "threads");
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
    FILE *mesh = fopen(named, "r+");
    assert_true(mesh && fseek(mesh, strlen("$MeshFormat\n"), SEEK_SET) == 0);
    fputs("2.1", mesh); /* a mesh format version that only Gmsh can read */
    fclose(mesh);
    trocar_scene *scene = cube_scene();
    OK(trocar_scene_set(scene, "mesh", named, &why));
    gmshInitialize(0, NULL, 0, &error);
    gmshOptionSetNumber("Mesh.MshFileVersion", 2.2, &error);
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
    assert_int_equal(_mm_getcsr() & ~0x3fu, before & ~0x3fu); /* unchanged apart from the sticky exception flags */
#endif
    double version = 0, binary = 1;
    gmshOptionGetNumber("Mesh.MshFileVersion", &version, &error);
    gmshOptionGetNumber("Mesh.Binary", &binary, &error);
    assert_true(version == 2.2 && binary == 0);
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
        cmocka_unit_test(a_worker_thread_serves_the_tick),
        cmocka_unit_test(moduli_change_beside_a_worker_thread), cmocka_unit_test(what_is_seen_fits_the_force),
        cmocka_unit_test(a_picture_keeps_what_was_seen), cmocka_unit_test(the_refined_mesh_carries_the_contacts),
        cmocka_unit_test(waiting_and_latency_are_told), cmocka_unit_test(a_base_on_a_spring_yields),
        cmocka_unit_test(a_model_may_be_its_mesh_alone), cmocka_unit_test(the_device_is_that_of_the_scene),
        cmocka_unit_test(a_rollout_does_not_depend_on_threads), cmocka_unit_test(a_host_keeps_its_gmsh_session_and_its_floating_point),
        cmocka_unit_test(the_version_is_that_of_the_header),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
