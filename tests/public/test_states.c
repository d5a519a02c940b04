/* Tests saved states in files: their size, which ones are refused, and that another process can continue from them. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "cube_mesh.h"
#include "trocar.h"

#include <cmocka.h>

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

enum { TICKS = 400, HALF = TICKS / 2, NEEDLES = 2 };

/* Returns a model with relaxing tissue and two needles. The tests insert the first needle, let it rest, and insert the second beside it. */
static trocar_model *model_with(const char *key, const char *value) {
    cube_mesh *cube = malloc(sizeof *cube);
    trocar_scene *scene;
    trocar_model *model;
    cube_create(cube);
    trocar_mesh arrays = cube_arrays(cube);
    OK(trocar_scene_create(&scene, &why));
    OK(trocar_scene_set_mesh(scene, &arrays, &why));
    free(cube);
    OK(trocar_scene_set_number(scene, "regions[body].youngs_modulus", 20e3, &why));
    OK(trocar_scene_set(scene, "membranes[skin].puncture_force", "0.5", &why));
    OK(trocar_scene_set(scene, "fixed", "[back]", &why));
    OK(trocar_scene_set(scene, "needles", "2", &why));
    OK(trocar_scene_set(scene, "relaxation[0].weight", "0.3", &why));
    OK(trocar_scene_set(scene, "relaxation[0].time", "0.2", &why));
    OK(trocar_scene_set(scene, key, value, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    return model;
}

static trocar_model *model_again(void) { return model_with("needle.bevel_slope", "0.05"); }

static trocar_pose pose_at(int needle, int tick) { return (trocar_pose){{1e-3 + 6e-3 * needle, 2e-3, -0.2005 + 75e-6 * tick}, {1, 0, 0, 0}}; }

static void push(trocar_sim *sim, int needle, int from, int to, trocar_output *outputs) {
    for (int t = from; t < to; t++) {
        trocar_pose base = pose_at(needle, t);
        OK(trocar_sim_step(sim, needle, &base, 1e-3, &outputs[t], &why));
    }
}

/* Returns a simulation in which the first needle rests and the second is half-way in. */
static trocar_sim *half_done(trocar_model *model) {
    static trocar_output outputs[TICKS];
    trocar_sim *sim;
    OK(trocar_sim_create(model, &sim, &why));
    for (int n = 0; n < NEEDLES; n++) {
        trocar_pose start = pose_at(n, 0);
        OK(trocar_sim_reset(sim, n, &start, &why));
    }
    push(sim, 0, 0, TICKS, outputs);
    assert_true(outputs[TICKS - 1].contacts > 2);
    OK(trocar_sim_drop_seeds(sim, 0, 1, 0.0, &why));
    OK(trocar_sim_leave(sim, 0, &why));
    push(sim, 1, 0, HALF, outputs);
    assert_int_equal(trocar_sim_needle_state(sim, 0), TROCAR_NEEDLE_RESTING);
    return sim;
}

static size_t save(const trocar_sim *sim, void **state) {
    size_t most = trocar_sim_state_size(sim);
    *state = malloc(most);
    OK(trocar_sim_save(sim, *state, most, &why));
    assert_true(trocar_state_bytes(*state) <= most);
    return trocar_state_bytes(*state);
}

/* Runs in a new process of this program: reads the state from the file, continues from it, and overwrites the file with the outputs. */
static int go_on(const char *path) {
    static trocar_output outputs[TICKS];
    static char state[1 << 23];
    FILE *file = fopen(path, "rb");
    size_t bytes = file ? fread(state, 1, sizeof state, file) : 0;
    trocar_sim *sim;
    if (file) fclose(file);
    trocar_model *model = model_again();
    if (trocar_sim_create(model, &sim, &why) != TROCAR_OK || trocar_sim_restore(sim, state, bytes, &why) != TROCAR_OK) {
        fprintf(stderr, "%s\n", why.text);
        return 1;
    }
    for (int t = HALF; t < TICKS; t++) {
        trocar_pose base = pose_at(1, t);
        if (trocar_sim_step(sim, 1, &base, 1e-3, &outputs[t], &why) != TROCAR_OK) return 1;
    }
    file = fopen(path, "wb");
    bool written = file && fwrite(outputs + HALF, sizeof *outputs, TICKS - HALF, file) == TICKS - HALF;
    trocar_sim_free(sim);
    trocar_model_free(model);
    return file && fclose(file) == 0 && written ? 0 : 1;
}

static void a_state_goes_on_in_another_process(void **unused) {
    (void)unused;
    static trocar_output here[TICKS], there[TICKS];
    char path[] = "/tmp/test_states.XXXXXX";
    int descriptor = mkstemp(path);
    trocar_model *model = model_again();
    trocar_sim *sim = half_done(model);
    void *state;
    size_t bytes = save(sim, &state);
    assert_true(bytes < 600000 && bytes < trocar_sim_state_size(sim) / 8);
    assert_int_equal(write(descriptor, state, bytes), (ssize_t)bytes);
    push(sim, 1, HALF, TICKS, here);
    pid_t child = fork();
    if (child == 0) {
        setenv("TROCAR_TEST_STATE", path, 1);
        execl("/proc/self/exe", "test_public", "test_states", (char *)NULL);
        _exit(99);
    }
    int status;
    waitpid(child, &status, 0);
    assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    FILE *file = fopen(path, "rb");
    assert_int_equal(fread(there + HALF, sizeof *there, TICKS - HALF, file), TICKS - HALF);
    fclose(file);
    assert_memory_equal(there + HALF, here + HALF, (TICKS - HALF) * sizeof *here);
    assert_true(fabs(here[TICKS - 1].force[2]) > 0.1);
    free(state);
    trocar_sim_free(sim);
    trocar_model_free(model);
    close(descriptor);
    unlink(path);
}

static void assert_refused(trocar_sim *sim, const void *state, size_t bytes, const char *words) {
    assert_int_equal(trocar_sim_restore(sim, state, bytes, &why), TROCAR_BAD_INPUT);
    if (!strstr(why.text, words)) fail_msg("\"%s\" lacks \"%s\"", why.text, words);
}

static void a_wrong_state_is_refused_and_changes_nothing(void **unused) {
    (void)unused;
    static trocar_output expected[TICKS], outputs[TICKS];
    trocar_model *model = model_again(), *other = model_with("regions[body].friction.kinetic", "6.9");
    trocar_sim *sim = half_done(model), *stranger;
    char *state;
    size_t bytes = save(sim, (void **)&state);
    char *damaged = malloc(bytes);
    assert_refused(sim, state, 5, "5 bytes");
    assert_refused(sim, state, bytes - 1, "are given");
    for (size_t at = 0; at < bytes; at += at < 64 ? 1 : 997) { /* a flipped bit is detected wherever it is */
        memcpy(damaged, state, bytes);
        damaged[at] ^= 4;
        assert_int_equal(trocar_sim_restore(sim, damaged, bytes, &why), TROCAR_BAD_INPUT);
        assert_true(strlen(why.text) > 10);
    }
    memcpy(damaged, state, bytes);
    damaged[0] = 'x';
    assert_refused(sim, damaged, bytes, "not a state");
    damaged[0] = state[0];
    damaged[bytes - 1] ^= 1;
    assert_refused(sim, damaged, bytes, "damaged");
    OK(trocar_sim_create(other, &stranger, &why));
    assert_refused(stranger, state, bytes, "another model");
    push(sim, 1, HALF, TICKS, outputs);
    OK(trocar_sim_restore(sim, state, bytes, &why));
    push(sim, 1, HALF, TICKS, expected);
    assert_memory_equal(outputs + HALF, expected + HALF, (TICKS - HALF) * sizeof *outputs);
    char small[64];
    assert_int_equal(trocar_sim_save(sim, small, sizeof small, &why), TROCAR_BAD_INPUT);
    free(damaged);
    free(state);
    trocar_sim_free(sim);
    trocar_sim_free(stranger);
    trocar_model_free(model);
    trocar_model_free(other);
}

/* Resets the needle to a pose inside the tissue, either directly or (`elsewhere`) after it has been at other poses, and then pushes it further. */
static void run_from_inside(trocar_model *model, bool elsewhere, trocar_output *outputs) {
    trocar_sim *sim;
    OK(trocar_sim_create(model, &sim, &why));
    if (elsewhere) {
        trocar_pose outside = pose_at(0, 0), oblique = {{-0.0337, 2e-3, -0.1825}, {0.9962, 0, 0.0872, 0}}; /* oblique: same tip, tilted by 10 degrees */
        OK(trocar_sim_reset(sim, 0, &outside, &why));
        push(sim, 0, 0, TICKS, outputs);
        OK(trocar_sim_reset(sim, 0, &oblique, &why));
        for (int t = 0; t < 5; t++) OK(trocar_sim_step(sim, 0, &oblique, 1e-3, outputs, &why));
    }
    trocar_pose inside = pose_at(0, HALF);
    OK(trocar_sim_reset(sim, 0, &inside, &why));
    push(sim, 0, HALF, TICKS, outputs);
    trocar_sim_free(sim);
}

static void after_a_reset_the_forces_do_not_depend_on_what_was_before(void **unused) {
    (void)unused;
    static trocar_output first[TICKS], later[TICKS];
    trocar_model *model = model_again();
    run_from_inside(model, false, first);
    run_from_inside(model, true, later);
    assert_true(fabs(first[TICKS - 1].force[2]) > 0.1);
    for (int t = HALF; t < TICKS; t++)
        for (int a = 0; a < 3; a++)
            if (fabs(first[t].force[a] - later[t].force[a]) > 1e-9) fail_msg("tick %d: %g and %g N", t, first[t].force[a], later[t].force[a]);
    trocar_model_free(model);
}

int main(void) {
    const char *path = getenv("TROCAR_TEST_STATE");
    if (path) return go_on(path);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_state_goes_on_in_another_process),
        cmocka_unit_test(a_wrong_state_is_refused_and_changes_nothing),
        cmocka_unit_test(after_a_reset_the_forces_do_not_depend_on_what_was_before),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
