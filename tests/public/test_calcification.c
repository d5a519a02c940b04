/* Tests, through trocar.h, calcifications: balls in the tissue that are harder to cut. */
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

static const double X = 0.005, Y = 0.003, LENGTH = 0.2, DT = 1e-3, SPEED = 0.05; /* m, s, m/s */
static const double CUTTING = 0.2; /* N */

/* Balls in the needle's path. Once the tip has passed the first ball, the tissue springs back by more than the second ball's thickness. The first ball uses
   the default factor. The forces are too small to buckle the needle. */
static const struct { const char *centre; double depth, radius, factor; } BALLS[] = {
    {"[0.005, 0.003, 0.03]", 0.03, 4e-3, 5.0}, {"[0.005, 0.003, 0.0365]", 0.0365, 1e-3, 8.0}};

/* Returns the figure-8 scene with the same cutting force everywhere and without friction, viscosity or puncture forces, so that cutting is the only force
   the hand feels. */
static trocar_scene *load_scene(void) {
    static const char *const NONE[] = {"cutting_viscosity", "friction.kinetic", "friction.static", "friction.viscous"};
    trocar_scene *scene;
    char key[64];
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    for (int i = 0; i < 2; i++) {
        snprintf(key, sizeof key, "regions[%d].cutting_force", i);
        OK(trocar_scene_set_number(scene, key, CUTTING, &why));
        for (size_t k = 0; k < sizeof NONE / sizeof *NONE; k++) {
            snprintf(key, sizeof key, "regions[%d].%s", i, NONE[k]);
            OK(trocar_scene_set_number(scene, key, 0.0, &why));
        }
        snprintf(key, sizeof key, "membranes[%d].puncture_force", i);
        OK(trocar_scene_set_number(scene, key, 0.0, &why));
    }
    for (int i = 0; i < 2; i++) {
        snprintf(key, sizeof key, "calcifications[%d].centre", i);
        OK(trocar_scene_set(scene, key, BALLS[i].centre, &why));
        snprintf(key, sizeof key, "calcifications[%d].radius", i);
        OK(trocar_scene_set_number(scene, key, BALLS[i].radius, &why));
    }
    OK(trocar_scene_set_number(scene, "calcifications[1].cutting_factor", BALLS[1].factor, &why));
    return scene;
}

static trocar_pose base_at(double depth) { return (trocar_pose){{X, Y, depth - LENGTH}, {1, 0, 0, 0}}; }

/* Inside a ball, the hand feels the cutting force times the ball's factor; in front of and behind the balls, the plain cutting force. At the boundary of a
   ball, the tip stops until it has dented the tissue enough to cut it. The tolerance is 1 % because the needle is not perfectly straight. */
static void cutting_a_calcification_takes_its_factor(void **state) {
    (void)state;
    static const double NEAR = 1e-4; /* m, more than the tip advances per tick in front of a ball or inside it */
    trocar_scene *scene = load_scene();
    trocar_model *model;
    trocar_sim *sim;
    double factor, before = 0.0, behind = 0.0;
    int waiting[2] = {0}, inside[2] = {0};
    OK(trocar_scene_get_number(scene, "calcifications[0].cutting_factor", &factor, &why));
    assert_true(factor == BALLS[0].factor && trocar_scene_count(scene, "calcifications") == 2);
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &sim, &why));
    trocar_scene_free(scene);
    trocar_pose base = base_at(-1e-3);
    OK(trocar_sim_reset(sim, 0, &base, &why));
    for (double depth = -1e-3; depth < 0.06; depth += SPEED * DT) {
        trocar_output out;
        base = base_at(depth);
        OK(trocar_sim_step(sim, 0, &base, DT, &out, &why));
        double force = -out.force[2];
        for (int i = 0; i < 2; i++) {
            double z = out.depth - BALLS[i].depth, r = BALLS[i].radius, plateau = BALLS[i].factor * CUTTING;
            if (fabs(z + r) < NEAR) waiting[i]++;
            if (fabs(z) > r - NEAR) continue;
            inside[i]++;
            assert_true(fabs(force - plateau) < 0.01 * plateau);
        }
        if (out.depth < BALLS[0].depth - BALLS[0].radius - NEAR) before = force;
        behind = force;
    }
    print_message("%.4f N before, %.4f N behind; %d and %d ticks at the boundary, %d and %d inside\n", before, behind, waiting[0], waiting[1], inside[0], inside[1]);
    assert_true(fabs(before - CUTTING) < 0.01 * CUTTING && fabs(behind - CUTTING) < 0.01 * CUTTING);
    assert_true(waiting[0] > 20 && waiting[1] > 20 && inside[0] > 50 && inside[1] > 10);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* A ball's centre must lie in the tissue. This can only be checked once the mesh has been read, but the message still names the line in the scene. */
static void a_centre_outside_the_tissue_is_refused_with_its_line(void **state) {
    (void)state;
    char path[] = "/tmp/calcification_XXXXXX", expected[128];
    trocar_scene *scene;
    trocar_model *model;
    int file = mkstemp(path);
    assert_true(file >= 0);
    dprintf(file, "mesh: " MESHES "/prostate.msh\nregions: [{name: prostate}, {name: surrounding}]\nfixed: [fixed]\ncalcifications:\n"
            "  - {centre: [0.005, 0.003, 0.03], radius: 1e-3}\n  - radius: 1e-3\n    centre: [0.005, 0.003, 3]\n");
    close(file);
    OK(trocar_scene_load(path, &scene, &why));
    assert_int_equal(trocar_model_create(scene, NULL, &model, &why), TROCAR_BAD_INPUT);
    snprintf(expected, sizeof expected, "%s:7: calcifications[1].centre: 0.005, 0.003, 3 m lies outside the tissue", path);
    if (strncmp(why.text, expected, strlen(expected)) != 0) fail_msg("%s", why.text);
    trocar_scene_free(scene);
    remove(path);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(cutting_a_calcification_takes_its_factor),
        cmocka_unit_test(a_centre_outside_the_tissue_is_refused_with_its_line),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
