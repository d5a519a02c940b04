/* Compares the forces of an insertion with the condensed inverse in single and in double precision. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "trocar.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

enum { IN = 700, TICKS = 1000 }; /* 1 ms ticks: 700 to insert by 70 mm, then a sideways motion of 6 mm */

/* Uses its own cache folder and removes it at the end, so that this test computes the inverse itself and no other test reads it. */
static trocar_model *create_model(const char *precision) {
    char directory[] = "/tmp/test_precision.XXXXXX", command[64];
    trocar_scene *scene;
    trocar_model *model;
    assert_non_null(mkdtemp(directory));
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    OK(trocar_scene_set(scene, "inverse", "condensed", &why));
    OK(trocar_scene_set(scene, "inverse_precision", precision, &why));
    OK(trocar_scene_set(scene, "cache", directory, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    snprintf(command, sizeof command, "rm -r %s", directory);
    assert_int_equal(system(command), 0);
    return model;
}

static void push(const char *precision, trocar_output outputs[TICKS]) {
    trocar_model *model = create_model(precision);
    trocar_sim *sim;
    trocar_pose base = {{0.001, 0.003, -0.201}, {1, 0, 0, 0}};
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_reset(sim, 0, &base, &why));
    for (int t = 0; t < TICKS; t++) {
        if (t < IN) base.position[2] += 1e-4;
        else base.position[1] += 2e-5;
        OK(trocar_sim_step(sim, 0, &base, 1e-3, &outputs[t], &why));
    }
    trocar_sim_free(sim);
    trocar_model_free(model);
}

static double size(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

static void forces_in_single_precision_are_those_in_double_precision(void **state) {
    (void)state;
    static trocar_output exact[TICKS], rounded[TICKS];
    push("double", exact);
    push("single", rounded);
    double largest = 0.0, error = 0.0;
    for (int t = 0; t < TICKS; t++) {
        double difference[3];
        for (int a = 0; a < 3; a++) difference[a] = rounded[t].force[a] - exact[t].force[a];
        largest = fmax(largest, size(exact[t].force));
        error = fmax(error, size(difference));
    }
    print_message("largest force %.3f N, largest difference %.2g of it\n", largest, error / largest);
    assert_true(largest > 1.0);
    assert_true(error > 0.0); /* not zero, because the two precisions must differ */
    assert_true(error < 1e-5 * largest);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(forces_in_single_precision_are_those_in_double_precision)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
