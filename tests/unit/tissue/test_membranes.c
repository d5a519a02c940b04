/* Tests, through trocar.h, membranes with in-plane stiffness: which models may share an inverse, saved inverses, relaxation, and their effect on a dent. The
   stiffness itself is compared with exact solutions and CalculiX in tests/verification/tissue/verify_membranes.py. */
#include <dirent.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "public/cube_mesh.h"

#include <cmocka.h>

static trocar_error why;
static char folder[] = "/tmp/test_membranes.XXXXXX", mesh_path[64];

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

static int make_folder(void **state) {
    (void)state;
    if (!mkdtemp(folder)) return -1;
    cube_mesh *cube = malloc(sizeof *cube);
    cube_create(cube);
    snprintf(mesh_path, sizeof mesh_path, "%s/cube.msh", folder);
    cube_write(cube, mesh_path);
    free(cube);
    return 0;
}

static int remove_folder(void **state) {
    (void)state;
    DIR *d = opendir(folder);
    char path[512];
    for (struct dirent *entry; d && (entry = readdir(d));) {
        snprintf(path, sizeof path, "%s/%s", folder, entry->d_name);
        unlink(path);
    }
    if (d) closedir(d);
    return rmdir(folder);
}

static int inverses_in_folder(void) {
    DIR *d = opendir(folder);
    int count = 0;
    for (struct dirent *entry; d && (entry = readdir(d));) count += strstr(entry->d_name, ".inverse") != NULL;
    closedir(d);
    return count;
}

/* Returns the cube with an impenetrable skin of this stiffness (N/m). Poisson's ratio is 0, because in incompressible tissue a dent does not stretch a flat
   skin to first order. */
static trocar_scene *scene_of(double stiffness) {
    trocar_scene *scene;
    OK(trocar_scene_create(&scene, &why));
    OK(trocar_scene_set(scene, "mesh", mesh_path, &why));
    OK(trocar_scene_set_number(scene, "regions[body].youngs_modulus", 20e3, &why));
    OK(trocar_scene_set_number(scene, "regions[body].poisson_ratio", 0, &why));
    OK(trocar_scene_set(scene, "membranes[skin].puncture_force", ".inf", &why));
    OK(trocar_scene_set_number(scene, "membranes[skin].stiffness", stiffness, &why));
    OK(trocar_scene_set(scene, "fixed", "[back]", &why));
    return scene;
}

static trocar_model *model_of(trocar_scene *scene) {
    trocar_model *model;
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    return model;
}

/* Presses the needle's tip 1 mm into the middle of the skin, holds it for `ticks` ticks, and returns the force against the needle in the last one. */
static double force_on_skin(trocar_model *model, int ticks) {
    trocar_sim *sim;
    trocar_output out = {0};
    trocar_pose base = {{1e-3, 2e-3, -0.2001}, {1, 0, 0, 0}};
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_reset(sim, 0, &base, &why));
    base.position[2] = -0.199;
    for (int i = 0; i < ticks; i++) OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    trocar_sim_free(sim);
    return -out.force[2];
}

static void the_model_knows_its_membranes(void **state) {
    (void)state;
    trocar_scene *scene = scene_of(250);
    OK(trocar_scene_set_number(scene, "membranes[skin].poisson_ratio", 0.3, &why));
    trocar_model *model = model_of(scene);
    int skin = trocar_model_find_region(model, "skin", 2), back = trocar_model_find_region(model, "back", 2), body = trocar_model_find_region(model, "body", 3);
    assert_true(trocar_model_membrane(model, skin).stiffness == 250 && trocar_model_membrane(model, skin).poisson_ratio == 0.3);
    assert_true(trocar_model_membrane(model, back).stiffness == 0 && trocar_model_membrane(model, body).stiffness == 0);
    assert_true(trocar_model_membrane(model, -1).stiffness == 0 && trocar_model_membrane(model, 32).stiffness == 0);
    trocar_model_free(model);
}

static void derive(trocar_model *base, trocar_scene *scene, const char *refused) {
    trocar_model *derived = NULL;
    trocar_status status = trocar_model_derive(base, scene, &derived, &why);
    if (refused) {
        assert_int_equal(status, TROCAR_BAD_INPUT);
        if (!strstr(why.text, refused)) fail_msg("\"%s\" lacks \"%s\"", why.text, refused);
    } else if (status != TROCAR_OK) fail_msg("%s", why.text);
    trocar_model_free(derived);
    trocar_scene_free(scene);
}

/* Models share an inverse only if their membranes are the same. Membranes without stiffness do not count. */
static void another_stiffness_is_not_shared(void **state) {
    (void)state;
    trocar_model *soft = model_of(scene_of(0)), *stiff = model_of(scene_of(250));
    derive(stiff, scene_of(250), NULL);
    derive(stiff, scene_of(251), "membranes[skin].stiffness: differs from that of the model to be shared");
    derive(stiff, scene_of(0), "membranes[skin].stiffness");
    derive(soft, scene_of(250), "membranes[skin].stiffness");
    trocar_scene *scene = scene_of(250);
    OK(trocar_scene_set_number(scene, "membranes[skin].poisson_ratio", 0.3, &why));
    derive(stiff, scene, "membranes[skin].poisson_ratio");
    scene = scene_of(0);
    OK(trocar_scene_set_number(scene, "membranes[skin].poisson_ratio", 0.3, &why));
    derive(soft, scene, NULL);
    scene = scene_of(250);
    OK(trocar_scene_set_number(scene, "membranes[back].puncture_force", 1, &why));
    derive(stiff, scene, NULL);
    scene = scene_of(250);
    OK(trocar_scene_set_number(scene, "membranes[back].puncture_force", 1, &why));
    OK(trocar_scene_set_number(scene, "membranes[back].stiffness", 1, &why));
    derive(stiff, scene, "membranes[back].stiffness");
    trocar_model_free(soft);
    trocar_model_free(stiff);
}

/* Each kind of inverse gives the same force, and a saved condensed inverse is used only for the membranes it was made for. */
static void saved_inverses_belong_to_their_membranes(void **state) {
    (void)state;
    double force[2][3];
    for (int stiff = 0; stiff < 2; stiff++)
        for (int kind = 0; kind < 3; kind++) {
            trocar_scene *scene = scene_of(stiff ? 1000 : 0);
            OK(trocar_scene_set(scene, "inverse", kind ? "condensed" : "dense", &why)); /* the third inverse is read from a file */
            OK(trocar_scene_set(scene, "cache", folder, &why));
            trocar_model *model = model_of(scene);
            force[stiff][kind] = force_on_skin(model, 5);
            trocar_model_free(model);
            assert_int_equal(inverses_in_folder(), stiff + (kind > 0));
        }
    for (int stiff = 0; stiff < 2; stiff++)
        for (int kind = 1; kind < 3; kind++)
            if (fabs(force[stiff][kind] / force[stiff][0] - 1) > 1e-6) fail_msg("%g N instead of %g N", force[stiff][kind], force[stiff][0]);
    assert_true(force[1][0] > 1.001 * force[0][0]); /* most of the compliance is local to the tip, where the membrane has no effect */
}

/* The stiffer the skin, the more force it takes to dent it. */
static void a_stiff_skin_resists_a_dent(void **state) {
    (void)state;
    double last = 0.0;
    for (double stiffness = 0; stiffness < 2e4; stiffness = stiffness > 0 ? 10 * stiffness : 10) {
        trocar_model *model = model_of(scene_of(stiffness));
        double force = force_on_skin(model, 5);
        assert_true(force > last);
        last = force;
        trocar_model_free(model);
    }
}

/* Membranes relax as the tissue does, so the force on a held needle drops by the series' factor, 1 - sum of weight (1 - exp(-t / time)). */
static void membranes_relax_with_the_tissue(void **state) {
    (void)state;
    enum { FIRST = 2, LAST = 400 };
    trocar_scene *scene = scene_of(1000);
    OK(trocar_scene_set_number(scene, "relaxation[0].weight", 0.3, &why));
    OK(trocar_scene_set_number(scene, "relaxation[0].time", 0.1, &why));
    trocar_model *model = model_of(scene), *elastic = model_of(scene_of(1000));
    double force = force_on_skin(model, LAST), at_once = force_on_skin(elastic, FIRST);
    double expected = 1 - 0.3 * (1 - exp(-(LAST - 1) * 1e-3 / 0.1));
    if (fabs(force / at_once / expected - 1) > 2e-3) fail_msg("%g of the force remains instead of %g", force / at_once, expected);
    trocar_model_free(model);
    trocar_model_free(elastic);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_model_knows_its_membranes), cmocka_unit_test(another_stiffness_is_not_shared),
        cmocka_unit_test(saved_inverses_belong_to_their_membranes), cmocka_unit_test(a_stiff_skin_resists_a_dent),
        cmocka_unit_test(membranes_relax_with_the_tissue),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
