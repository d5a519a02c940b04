/* Tests, through trocar.h, that the hand feels no artefacts caused by mesh nodes, by skin that other needles have displaced, or by buckling. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "trocar.h"

#include "check.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

static trocar_scene *load(const char *name) {
    trocar_scene *scene;
    char path[500];
    snprintf(path, sizeof path, MESHES "/%s.yaml", name);
    OK(trocar_scene_load(path, &scene, &why));
    return scene;
}

static trocar_sim *simulate(trocar_scene *scene, trocar_model **model) {
    trocar_sim *sim;
    OK(trocar_model_create(scene, NULL, model, &why));
    trocar_scene_free(scene);
    OK(trocar_sim_create(*model, &sim, &why));
    return sim;
}

static double norm(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

enum { RECOIL = 30 }; /* ms, how long the tissue recoils after a puncture */

/* Moves the base along z by `way` (m), in 1 ms ticks of at most `step` (m), and returns the magnitude of the last force. `most`, if given, receives the
   largest change in force (N) over the ticks that report any of `events`, except shortly after a puncture. */
static double move(trocar_sim *sim, int needle, trocar_pose *base, double way, double step, unsigned events, double *most) {
    trocar_output out = {0};
    double last[3] = {0}, change[3];
    int ticks = (int)ceil(fabs(way) / step), since = RECOIL;
    for (int i = 0; i < ticks; i++) {
        base->position[2] += way / ticks;
        OK(trocar_sim_step(sim, needle, base, 1e-3, &out, &why));
        for (int a = 0; a < 3; a++) change[a] = out.force[a] - last[a], last[a] = out.force[a];
        since = out.events & TROCAR_EVENT_PUNCTURED ? 0 : since + 1;
        if (most && i > 0 && since > RECOIL && out.events & events) *most = fmax(*most, norm(change));
    }
    return norm(out.force);
}

/* Holds the needle at rest for `ticks` ticks of 1 ms. */
static void hold(trocar_sim *sim, int needle, const trocar_pose *base, int ticks, trocar_output *out) {
    for (int i = 0; i < ticks; i++) OK(trocar_sim_step(sim, needle, base, 1e-3, out, &why));
}

static trocar_pose above(double x, double y) { return (trocar_pose){{x, y, -0.202}, {1, 0, 0, 0}}; }

/* Inserts a needle into intact tissue and then along its old track, where the tip's cutting resistance is smaller than the friction attributed to the tip. */
static void nodes_that_are_added_are_not_felt(void **state) {
    (void)state;
    trocar_model *model;
    trocar_sim *sim = simulate(load("implant"), &model);
    trocar_pose base = {{0.005, 0.005, -0.23}, {1, 0, 0, 0}};
    OK(trocar_sim_reset(sim, 0, &base, &why));
    for (int insertion = 0; insertion < 2; insertion++) {
        double added = 0.0, deep = move(sim, 0, &base, 0.1, 2e-5, TROCAR_EVENT_ADDED, &added);
        print_message("insertion %d: %.2f N, changes by at most %.4f N where a node is added\n", insertion + 1, deep, added);
        assert_true(deep > 0.3 && added < 0.02);
        move(sim, 0, &base, -0.1, 5e-5, 0, NULL);
    }
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* Withdraws a needle from tissue that stiffens under load. */
static void nodes_that_are_removed_are_not_felt(void **state) {
    (void)state;
    trocar_model *model;
    trocar_scene *scene = load("figure8");
    static const char *const regions[] = {"prostate", "surrounding"};
    for (int i = 0; i < 2; i++) {
        char key[80];
        snprintf(key, sizeof key, "regions[%s].stiffening", regions[i]);
        OK(trocar_scene_set_number(scene, key, 1.5, &why));
        snprintf(key, sizeof key, "regions[%s].friction.static", regions[i]);
        OK(trocar_scene_set_number(scene, key, 60.0, &why));
        snprintf(key, sizeof key, "regions[%s].friction.kinetic", regions[i]);
        OK(trocar_scene_set_number(scene, key, 50.0, &why));
    }
    trocar_sim *sim = simulate(scene, &model);
    trocar_pose base = above(0.001, 0.002);
    OK(trocar_sim_reset(sim, 0, &base, &why));
    double removed = 0.0;
    move(sim, 0, &base, 0.05, 5e-5, 0, NULL);
    move(sim, 0, &base, -0.052, 2e-5, TROCAR_EVENT_REMOVED, &removed);
    print_message("changes by at most %.4f N where a node is removed\n", removed);
    assert_true(removed < 0.02);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* Presses on the skin without puncturing it. The tissue must respond in the same way whether the puncture force is infinite or a million newtons. */
static void infinite_force_leaves_the_tissue_as_soft(void **state) {
    (void)state;
    double force[2];
    for (int i = 0; i < 2; i++) {
        trocar_model *model;
        trocar_scene *scene = load("figure8");
        OK(trocar_scene_set(scene, "membranes[skin].puncture_force", i ? ".inf" : "1e6", &why));
        trocar_sim *sim = simulate(scene, &model);
        trocar_pose base = above(0.001, 0.002);
        OK(trocar_sim_reset(sim, 0, &base, &why));
        force[i] = move(sim, 0, &base, 0.007, 2e-5, 0, NULL);
        trocar_sim_free(sim);
        trocar_model_free(model);
    }
    print_message("5 mm: %.4f N, never pierced %.4f N\n", force[0], force[1]);
    assert_true(force[0] > 0.1 && fabs(force[1] / force[0] - 1.0) < 1e-6);
}

/* A needle buckles against the pubic arch, is moved sideways and withdrawn, and is then inserted at another point. */
static void a_buckled_needle_recovers_off_its_axis(void **state) {
    (void)state;
    trocar_model *model;
    trocar_sim *sim = simulate(load("prostate"), &model);
    trocar_pose base = {{0.013, 0.012, -0.202}, {1, 0, 0, 0}};
    trocar_output out = {0};
    OK(trocar_sim_reset(sim, 0, &base, &why));
    for (int i = 0; i < 2000; i++) {
        base.position[2] += 2e-5;
        OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    }
    for (int i = 0; i < 100; i++) {
        base.position[1] -= 6e-5;
        OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    }
    assert_true(norm(out.force) > 5.0 && !(out.events & TROCAR_EVENT_UNSTABLE)); /* it has buckled but still bears load */
    move(sim, 0, &base, -0.21 - base.position[2], 1e-4, 0, NULL);
    for (int i = 0; i < 200; i++) {
        base.position[0] -= 6e-5, base.position[1] -= 5e-5;
        OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    }
    double force = move(sim, 0, &base, 0.03, 5e-5, 0, NULL);
    print_message("elsewhere: %.2f N\n", force);
    assert_true(force > 0.3);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* Inserts twelve needles into soft tissue. Each time, the needles already in place have displaced the skin at the entry point. */
static void no_needle_goes_in_unfelt(void **state) {
    (void)state;
    static const double across[] = {-0.015, -0.005, 0.005, 0.015}, up[] = {-0.010, -0.005, 0.005, 0.010};
    for (int tip = 0; tip < 2; tip++) { /* two tip depths: 72.8 and 73.5 mm */
        trocar_model *model;
        trocar_scene *scene = load("implant");
        double end = tip ? 73.5e-3 : 72.8e-3;
        OK(trocar_scene_set_number(scene, "regions[surrounding].youngs_modulus", 3e3, &why));
        trocar_sim *sim = simulate(scene, &model);
        for (int n = 0; n < 12; n++) {
            trocar_pose base = {{across[n / 4], up[n % 4], -0.23}, {1, 0, 0, 0}};
            trocar_output out;
            OK(trocar_sim_reset(sim, n, &base, &why));
            move(sim, n, &base, 0.03 + end, 8e-5, 0, NULL);
            hold(sim, n, &base, 300, &out);
            if (!(out.depth > 0.03 && norm(out.force) > 0.5)) fail_msg("needle %d is %.1f mm deep and bears %.2f N, events %#x", n, 1e3 * out.depth, norm(out.force), out.events);
            OK(trocar_sim_leave(sim, n, &why));
        }
        trocar_sim_free(sim);
        trocar_model_free(model);
    }
}

/* Moves the base by 12 mm in a single 1 ms tick, starting at the skin. */
static void a_gap_in_the_poses_is_no_buckling(void **state) {
    (void)state;
    trocar_model *model;
    trocar_sim *sim = simulate(load("implant"), &model);
    trocar_pose base = {{0.005, 0.005, -0.2005}, {1, 0, 0, 0}};
    trocar_output out;
    OK(trocar_sim_reset(sim, 0, &base, &why));
    move(sim, 0, &base, 0.0005, 5e-5, 0, NULL);
    base.position[2] += 0.012;
    OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    assert_false(out.events & TROCAR_EVENT_UNSTABLE);
    double force = move(sim, 0, &base, 0.02, 1e-4, 0, NULL);
    print_message("20 mm after a 12 mm gap: %.2f N\n", force);
    assert_true(force > 2.0);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* The worker releases a needle in a single update. A hand that holds a nearby needle must still feel the release spread over 0.1 s, as if the other hand
   were opening its fingers gradually. */
static void letting_go_of_a_needle_is_no_knock_for_its_neighbours(void **state) {
    (void)state;
    trocar_model *model;
    trocar_scene *scene = load("figure8");
    OK(trocar_scene_set_number(scene, "needles", 3, &why));
    trocar_sim *sim = simulate(scene, &model);
    trocar_pose base[3];
    trocar_output out, before;
    for (int n = 0; n < 3; n++) { /* the first rests, the second is held, and the third is released while being pushed */
        base[n] = (trocar_pose){{5e-3 * (n - 1), 0.0, -0.23}, {1, 0, 0, 0}};
        OK(trocar_sim_reset(sim, n, &base[n], &why));
        move(sim, n, &base[n], n == 2 ? 0.09 : 0.08, 1e-4, 0, NULL);
        if (n == 0) OK(trocar_sim_leave(sim, n, &why));
    }
    hold(sim, 1, &base[1], 20, &before);
    OK(trocar_sim_leave(sim, 2, &why));
    double last[3], most = 0.0, way[3];
    size_t size = trocar_sim_state_size(sim);
    void *half_way = malloc(size);
    for (int a = 0; a < 3; a++) last[a] = before.force[a];
    for (int i = 0; i < 200; i++) {
        double change[3];
        if (i == 50) OK(trocar_sim_save(sim, half_way, size, &why));
        OK(trocar_sim_step(sim, 1, &base[1], 1e-3, &out, &why));
        for (int a = 0; a < 3; a++) change[a] = out.force[a] - last[a], last[a] = out.force[a], way[a] = out.force[a] - before.force[a];
        most = fmax(most, norm(change));
    }
    print_message("let go of: %.3f N beside it, at most %.4f N in a tick\n", norm(way), most);
    assert_true(norm(way) > 0.1 && most < 0.05);
    OK(trocar_sim_restore(sim, half_way, size, &why)); /* a state saved half-way must continue in the same way */
    hold(sim, 1, &base[1], 150, &out);
    for (int a = 0; a < 3; a++) assert_true(fabs(out.force[a] - last[a]) < 1e-9);
    free(half_way);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* Relaxing tissue springs back slowly. A needle that is withdrawn and inserted again must meet the skin where it is now, not where it will end up. */
static void a_needle_returns_to_skin_that_is_still_displaced_with_one_touch(void **state) {
    (void)state;
    trocar_model *model;
    trocar_sim *sim = simulate(load("implant"), &model);
    trocar_pose base = {{0.005, 0.005, -0.2005}, {1, 0, 0, 0}};
    trocar_output out;
    OK(trocar_sim_reset(sim, 0, &base, &why));
    move(sim, 0, &base, 0.04, 1e-4, 0, NULL);
    hold(sim, 0, &base, 1000, &out);
    move(sim, 0, &base, -0.0405, 1e-4, 0, NULL);
    int touched = 0, withdrawn = 0, felt = 0;
    for (int i = 0; i < 1000; i++) {
        base.position[2] += 2e-6;
        OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
        touched += (out.events & TROCAR_EVENT_TOUCHED) != 0;
        withdrawn += (out.events & TROCAR_EVENT_WITHDRAWN) != 0;
        felt += norm(out.force) > 0.0;
    }
    print_message("touched %d times, withdrawn %d times, felt in %d ticks\n", touched, withdrawn, felt);
    assert_true(touched == 1 && withdrawn == 0 && felt > 100);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* The tip slides over the skin from one element to the next. The tissue's compliance at the tip must be available in every tick. */
static void gliding_over_the_skin_is_never_late(void **state) {
    (void)state;
    static const double tilts[] = {0.0, M_PI / 6.0};
    for (int i = 0; i < 2; i++) {
        double a = tilts[i], axis[3] = {sin(a), 0.0, cos(a)}, tip[3] = {-0.015, 0.004, -0.0005};
        trocar_model *model;
        trocar_scene *scene = load("figure8");
        OK(trocar_scene_set_number(scene, "membranes[skin].puncture_force", 1e3, &why));
        trocar_sim *sim = simulate(scene, &model);
        trocar_pose base = {.orientation = {cos(a / 2.0), 0.0, sin(a / 2.0), 0.0}};
        trocar_output out = {0};
        int late = 0, felt = 0;
        for (int k = 0; k < 3; k++) base.position[k] = tip[k] - 0.2 * axis[k];
        OK(trocar_sim_reset(sim, 0, &base, &why));
        for (int t = 0; t < 475; t++) { /* pressed 1 mm into the skin, then moved 20 mm along it */
            for (int k = 0; k < 3; k++) base.position[k] += t < 75 ? 2e-5 * axis[k] : k == 0 ? 5e-5 : 0.0;
            OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
            late += (out.events & TROCAR_EVENT_LATE) != 0;
            felt += norm(out.force) > 0.01;
        }
        print_message("tilted by %.0f degrees: felt in %d ticks, late in %d\n", a * 180.0 / M_PI, felt, late);
        assert_true(felt > 300 && late == 0);
        trocar_sim_free(sim);
        trocar_model_free(model);
    }
}

enum { PUSHES = 600 }; /* ticks during which the needle is pushed in after touching the skin */

/* Touches the skin in a tick in which the tip moves by `aside` (m) along x and 10 um along the needle, then pushes the needle in by 12 mm. Writes the axial
   force of each tick to `along`. Returns the tick in which the skin was punctured. */
static int push_after_touch(double aside, double *along) {
    trocar_model *model;
    trocar_scene *scene = load("figure8");
    for (int i = 0; i < 2; i++) OK(trocar_scene_set_number(scene, (const char *[]){"regions[surrounding].stiffening", "regions[prostate].stiffening"}[i], 2.0, &why));
    trocar_sim *sim = simulate(scene, &model);
    trocar_pose base = {{0.005 - aside, 0.003, -0.2 - 5e-6}, {1, 0, 0, 0}};
    trocar_output out = {0};
    int punctured = 0;
    OK(trocar_sim_reset(sim, 0, &base, &why));
    base.position[0] += aside;
    base.position[2] += 1e-5;
    OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    assert_true(out.events & TROCAR_EVENT_TOUCHED);
    for (int t = 0; t < PUSHES; t++) {
        base.position[2] += 2e-5;
        OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
        if (out.events & TROCAR_EVENT_PUNCTURED && !punctured) punctured = t;
        along[t] = out.force[2];
    }
    trocar_sim_free(sim);
    trocar_model_free(model);
    return punctured;
}

/* How the hand approached the skin does not affect the forces afterwards. */
static void a_needle_that_comes_from_the_side_feels_the_same_skin(void **state) {
    (void)state;
    static double straight[PUSHES], aside[PUSHES];
    int punctured = push_after_touch(0.0, straight), later = push_after_touch(2e-5, aside) - punctured;
    double most = 0.0, differs = 0.0;
    for (int t = 0; t < PUSHES; t++) {
        most = fmax(most, fabs(straight[t]));
        differs = fmax(differs, fabs(aside[t] - straight[t]));
    }
    print_message("largest difference %.4f of %.3f N; punctured in tick %d, from the side %d ticks later\n", differs, most, punctured, later);
    assert_true(punctured > 100 && later == 0 && differs < 0.01 * most);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nodes_that_are_added_are_not_felt),
        cmocka_unit_test(nodes_that_are_removed_are_not_felt),
        cmocka_unit_test(infinite_force_leaves_the_tissue_as_soft),
        cmocka_unit_test(a_buckled_needle_recovers_off_its_axis),
        cmocka_unit_test(no_needle_goes_in_unfelt),
        cmocka_unit_test(a_gap_in_the_poses_is_no_buckling),
        cmocka_unit_test(a_needle_returns_to_skin_that_is_still_displaced_with_one_touch),
        cmocka_unit_test(gliding_over_the_skin_is_never_late),
        cmocka_unit_test(a_needle_that_comes_from_the_side_feels_the_same_skin),
        cmocka_unit_test(letting_go_of_a_needle_is_no_knock_for_its_neighbours),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
