/* Tests, through trocar.h, guides: scene keys, the hole each needle occupies, contacts, restored states and refused scenes. */
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

enum { IN = 500 }; /* length of the insertion in 1 ms ticks */

/* A template with 5 x 3 holes, 5 mm apart, whose back face is 5 mm in front of the skin. */
static const char *const TEMPLATE[][2] = {
    {"guides[template].origin", "[0.005, 0.003, -0.025]"}, {"guides[template].normal", "[0, 0, 1]"}, {"guides[template].along", "[1, 0, 0]"},
    {"guides[template].columns", "5"}, {"guides[template].rows", "3"}, {"guides[template].hole_diameter", "1.47e-3"},
};

static trocar_scene *create_scene(const char *needles) {
    trocar_scene *scene;
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    OK(trocar_scene_set(scene, "needles", needles, &why));
    for (size_t i = 0; i < sizeof TEMPLATE / sizeof *TEMPLATE; i++) OK(trocar_scene_set(scene, TEMPLATE[i][0], TEMPLATE[i][1], &why));
    return scene;
}

static trocar_model *create_model(const char *needles) {
    trocar_model *model;
    trocar_scene *scene = create_scene(needles);
    assert_int_equal(trocar_scene_count(scene, "guides"), 1);
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    return model;
}

/* Returns the base's pose. Needle 0 starts in front of hole 6, left of the centre, and needle 1 in front of hole 8. Both tips start 5 mm in front of the
   plate, and the needles drift sideways on the way in. */
static trocar_pose base_at(int needle, int tick) {
    return (trocar_pose){{needle == 0 ? 0.0 - 4e-6 * tick : 0.010, 0.003 + 4e-6 * needle * tick, -0.23 + 1.2e-4 * tick}, {1, 0, 0, 0}};
}

static void each_needle_has_its_hole(void **state) {
    (void)state;
    trocar_model *model = create_model("2");
    trocar_sim *sim;
    OK(trocar_sim_create(model, &sim, &why));
    for (int n = 0; n < 2; n++) {
        trocar_pose start = base_at(n, 0);
        OK(trocar_sim_reset(sim, n, &start, &why));
        assert_int_equal(trocar_view_hole(trocar_sim_view(sim), n, 0), TROCAR_NO_HOLE);
    }
    trocar_output out[2];
    for (int t = 1; t <= IN; t++)
        for (int n = 0; n < 2; n++) {
            trocar_pose base = base_at(n, t);
            OK(trocar_sim_step(sim, n, &base, 1e-3, &out[n], &why));
            assert_false(out[n].events & (TROCAR_EVENT_MISSED_GUIDE | TROCAR_EVENT_UNSTABLE));
        }
    assert_int_equal(trocar_view_hole(trocar_sim_view(sim), 0, 0), 6);
    assert_int_equal(trocar_view_hole(trocar_sim_view(sim), 1, 0), 8);
    assert_int_equal(trocar_view_hole(trocar_sim_view(sim), 0, 1), TROCAR_NO_HOLE);
    for (int n = 0; n < 2; n++) { /* forces on hand, tissue and guide add up to zero */
        trocar_contact contacts[TROCAR_MAX_POINTS];
        int count = trocar_view_contacts(trocar_sim_view(sim), n, contacts, TROCAR_MAX_POINTS), guided = 0;
        double sum[3] = {0};
        for (int i = 0; i < count; i++) {
            if (contacts[i].kind == TROCAR_CONTACT_GUIDE) {
                guided++;
                assert_true(contacts[i].slot == 0 && contacts[i].id == 0 && contacts[i].depth == 0.0);
                assert_true(contacts[i].position[2] > -0.026 && contacts[i].position[2] < -0.004);
            }
            assert_true(i == 0 || contacts[i].arc > contacts[i - 1].arc);
            for (int a = 0; a < 3; a++) sum[a] += contacts[i].force[a];
        }
        assert_true(guided > 0 && contacts[count - 1].kind == TROCAR_CONTACT_TIP && count == guided + out[n].contacts + 1);
        for (int a = 0; a < 3; a++) assert_true(fabs(sum[a] + out[n].force[a]) < 1e-9);
    }
    trocar_sim_free(sim);
    trocar_model_free(model);
}

static void a_restored_needle_is_in_the_same_hole(void **state) {
    (void)state;
    trocar_model *model = create_model("1");
    trocar_sim *sim, *other;
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_create(model, &other, &why));
    trocar_pose start = base_at(0, 0);
    trocar_output out, again;
    OK(trocar_sim_reset(sim, 0, &start, &why));
    size_t size = trocar_sim_state_size(sim);
    void *saved = malloc(size);
    for (int t = 1; t <= IN; t++) {
        trocar_pose base = base_at(0, t);
        OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
        if (t < IN / 2) continue;
        if (t == IN / 2) {
            OK(trocar_sim_save(sim, saved, size, &why));
            OK(trocar_sim_restore(other, saved, size, &why));
            assert_int_equal(trocar_view_hole(trocar_sim_view(other), 0, 0), 6);
            continue;
        }
        OK(trocar_sim_step(other, 0, &base, 1e-3, &again, &why));
        assert_memory_equal(&out, &again, sizeof out);
    }
    free(saved);
    trocar_sim_free(sim);
    trocar_sim_free(other);
    trocar_model_free(model);
}

static void the_model_tells_where_the_holes_are(void **state) {
    (void)state;
    trocar_scene *scene = create_scene("1");
    trocar_model *model;
    trocar_model_options mesh_only = {.mesh_only = 1};
    OK(trocar_model_create(scene, &mesh_only, &model, &why));
    assert_int_equal(trocar_model_guide_count(model), 1);
    trocar_guide g = trocar_model_guide(model, 0), none = trocar_model_guide(model, 1);
    assert_true(g.columns == 5 && g.rows == 3 && g.spacing == 5e-3 && g.thickness == 20e-3 && fabs(g.hole_diameter - 1.47e-3) < 1e-12);
    assert_true(g.origin[2] == -0.025 && g.normal[2] == 1.0 && g.across[0][0] == 1.0 && g.across[1][1] == 1.0);
    assert_int_equal(none.columns, 0);
    trocar_model_free(model);
    trocar_scene_free(scene);
}

/* This error is only detected when the library reads the mesh. The message still names the file, the line of the `origin` key, the key itself and the
   remedy. */
static void a_guide_in_the_tissue_is_refused(void **state) {
    (void)state;
    char path[] = "/tmp/test_guided.XXXXXX.yaml", expected[128];
    int file = mkstemps(path, 5);
    FILE *out = fdopen(file, "w");
    fprintf(out, "mesh: " MESHES "/prostate-570.msh\nregions: [{name: prostate}, {name: surrounding}]\nfixed: [fixed]\n"
                 "guides:\n  - name: template\n    normal: [0, 0, 1]\n    origin: [0.005, 0.003, -0.01]\n    hole_diameter: 2e-3\n");
    fclose(out);
    trocar_scene *scene;
    trocar_model *model;
    trocar_model_options mesh_only = {.mesh_only = 1};
    OK(trocar_scene_load(path, &scene, &why));
    assert_int_equal(trocar_model_create(scene, &mesh_only, &model, &why), TROCAR_BAD_INPUT);
    snprintf(expected, sizeof expected, "%s:7: guides[0].origin: ", path);
    if (strncmp(why.text, expected, strlen(expected)) != 0) fail_msg("%s", why.text);
    assert_non_null(strstr(why.text, "move the origin back"));
    OK(trocar_scene_set(scene, "guides[0].thickness", "0.0099", &why));
    OK(trocar_model_create(scene, &mesh_only, &model, &why));
    trocar_model_free(model);
    trocar_scene_free(scene);
    unlink(path);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(each_needle_has_its_hole),
        cmocka_unit_test(a_restored_needle_is_in_the_same_hole),
        cmocka_unit_test(the_model_tells_where_the_holes_are),
        cmocka_unit_test(a_guide_in_the_tissue_is_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
