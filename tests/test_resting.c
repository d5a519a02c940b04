/* Needles that rest: left, taken and removed through trocar.h, against dense linear algebra of needles and tissue together. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <lapacke.h>

#include "api/api.h"

#include <cmocka.h>

#include "check.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

static trocar_model *create_model(const char *file, int needles) {
    char path[512], count[16];
    trocar_scene *scene;
    trocar_model *model;
    snprintf(path, sizeof path, MESHES "/%s", file);
    snprintf(count, sizeof count, "%d", needles);
    OK(trocar_scene_load(path, &scene, &why));
    OK(trocar_scene_set(scene, "needles", count, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    return model;
}

static trocar_pose at(double x, double y, double z) { return (trocar_pose){{x, y, z}, {1, 0, 0, 0}}; }

/* 50 mm deep at 0.1 m/s, straight along z, then held until the forces stay. */
static void push(trocar_sim *sim, int needle, double x, double y, int ticks, trocar_output *output) {
    trocar_pose base = at(x, y, -0.201);
    OK(trocar_sim_reset(sim, needle, &base, &why));
    for (int t = 0; t < ticks; t++) {
        base.position[2] += 1e-4;
        OK(trocar_sim_step(sim, needle, &base, 1e-3, output, &why));
    }
}

static void hold(trocar_sim *sim, int needle, int ticks, trocar_output *output) {
    trocar_pose base = trocar_sim_base(sim, needle);
    for (int t = 0; t < ticks; t++) OK(trocar_sim_step(sim, needle, &base, 1e-3, output, &why));
}

static void leave(trocar_sim *sim, int needle) {
    OK(trocar_sim_leave(sim, needle, &why));
    assert_int_equal(trocar_sim_needle_state(sim, needle), TROCAR_NEEDLE_LEAVING);
    OK(trocar_sim_work(sim, NULL, &why));
    assert_int_equal(trocar_sim_needle_state(sim, needle), TROCAR_NEEDLE_RESTING);
}

static double norm(const double f[3]) { return sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]); }

static void left_and_taken_again(void **state) {
    (void)state;
    trocar_model *model = create_model("figure8.yaml", 2);
    trocar_sim *sim;
    trocar_output out;
    trocar_contact before[TROCAR_MAX_POINTS], after[TROCAR_MAX_POINTS];
    OK(trocar_sim_create(model, &sim, &why));
    push(sim, 0, 0.0, 0.0, 500, &out);
    print_message("pushed: %.3f N\n", norm(out.force));
    hold(sim, 0, 50, &out);
    trocar_pose pushed = trocar_sim_base(sim, 0);
    leave(sim, 0);
    trocar_pose rests = trocar_sim_base(sim, 0);
    print_message("base moves by %.3f mm\n", 1e3 * (rests.position[2] - pushed.position[2]));
    int count = trocar_sim_contacts(sim, 0, before, TROCAR_MAX_POINTS);
    assert_true(count > 5);
    assert_int_equal(trocar_sim_step(sim, 0, &rests, 1e-3, &out, &why), TROCAR_BAD_INPUT);
    assert_int_equal(trocar_sim_tick(sim, 0, &rests, 1e-3, &out), TROCAR_BAD_INPUT);
    OK(trocar_sim_take(sim, 0, &why));
    OK(trocar_sim_step(sim, 0, &rests, 1e-3, &out, &why));
    assert_int_equal(trocar_sim_needle_state(sim, 0), TROCAR_NEEDLE_HELD);
    assert_int_equal(trocar_sim_contacts(sim, 0, after, TROCAR_MAX_POINTS), count);
    double worst = 0.0, largest = 0.0;
    for (int i = 0; i < count; i++) {
        double off[3];
        for (int a = 0; a < 3; a++) off[a] = after[i].force[a] - before[i].force[a];
        worst = fmax(worst, norm(off));
        largest = fmax(largest, norm(before[i].force));
    }
    print_message("taken: %.2e N at the base, contacts' forces within %.1e N of up to %.3f N\n", norm(out.force), worst, largest);
    assert_true(norm(out.force) < 2e-3 && worst < 1e-4 && largest > 0.01);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(left_and_taken_again),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
