#include "shared/motion.h"
#include "trocar.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <cmocka.h>

static const pose start = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};

static vec3 at(const char *name, double t) { return motion_pose(motion_find(name), start, t).position; }

static void assert_near(vec3 a, vec3 b) { assert_true(v3_norm(v3_sub(a, b)) < 1e-12); }

/* The times given in the paper's section on figure 8. */
static void figure8_follows_the_paper(void **state) {
    (void)state;
    assert_near(at("figure8", 0), start.position);
    assert_near(at("figure8", 1.3), v3(0.005, 0.003, -0.135));
    assert_true(at("figure8", 1.35).y > 0.003);
    assert_near(v3(0, 0, at("figure8", 1.4).z), v3(0, 0, -0.135));
    assert_near(at("figure8", 2.1), v3(0.005, 0.013, -0.201));
    assert_near(at("figure8", 2.4), v3(0.005, 0.013, -0.201));
}

/* The 200 mm needle reaches the skin, z = 0, after 1 mm, between 0.1 and 0.2 s. The paper gives 0.1 s. */
static void figure8_reaches_the_skin_early(void **state) {
    (void)state;
    assert_true(at("figure8", 0.10).z + 0.2 < 0);
    assert_true(at("figure8", 0.20).z + 0.2 > 0);
}

static void leg_fraction_is_symmetric(void **state) {
    (void)state;
    assert_true(motion_fraction(1, 2, 0.5) == 0 && motion_fraction(1, 2, 2.5) == 1);
    for (double t = 1; t <= 2; t += 0.01)
        assert_true(fabs(motion_fraction(1, 2, t) + motion_fraction(1, 2, 3 - t) - 1) < 1e-12);
    assert_true(fabs(motion_fraction(0, 2, 0.5) - 53.0 / 512.0) < 1e-12);  /* 10 x^3 - 15 x^4 + 6 x^5 at x = 1/4 */
}

/* Second differences stay below the sum of the accelerations of the motion's legs, 5.8 distance / time^2, so neither position nor velocity jumps. */
static void all_scripts_are_smooth_and_return(void **state) {
    (void)state;
    static const double dt = 1e-3, fastest = 0.2, most_acceleration = 4;  /* m/s, m/s^2 */
    for (int i = 0; motion_at(i); i++) {
        const motion *script = motion_at(i);
        for (double t = -0.1; t < 2 * script->period; t += dt) {
            vec3 a = motion_pose(script, start, t).position, b = motion_pose(script, start, t + dt).position,
                 c = motion_pose(script, start, t + 2 * dt).position;
            assert_true(v3_norm(v3_sub(b, a)) <= fastest * dt);
            assert_true(v3_norm(v3_add(v3_sub(c, b), v3_sub(a, b))) <= most_acceleration * dt * dt);
        }
        pose home = motion_pose(script, start, script->period);
        assert_near(home.position, start.position);
        assert_true(v3_norm(q_log(home.orientation)) < 1e-9);
        assert_true(script->duration <= script->period && script->leg_count <= MOTION_MAX_LEGS);
    }
}

static void roll_turns_about_the_needles_axis(void **state) {
    (void)state;
    pose p = motion_pose(motion_find("roll"), start, 1.45);
    vec3 axis = q_rotate(p.orientation, v3(0, 0, 1)), normal = q_rotate(p.orientation, v3(1, 0, 0));
    assert_near(axis, v3(0, 0, 1));
    assert_near(normal, v3(-1, 0, 0));
}

static void shifts_are_along_the_axes_of_the_start(void **state) {
    (void)state;
    const motion *script = motion_find("sweep");
    pose tilted = {{0.01, 0.02, 0.03}, q_exp(v3(0.4, -0.3, 0.2))};
    for (double t = 0; t < script->period; t += 0.1) {
        vec3 along = v3_sub(motion_pose(script, start, t).position, start.position);
        assert_near(motion_pose(script, tilted, t).position, v3_add(tilted.position, q_rotate(tilted.orientation, along)));
    }
}

static void a_deeper_script_is_as_fast(void **state) {
    (void)state;
    const motion *insert = motion_find("insert");
    motion deep = motion_to_depth(insert, 0.150);
    double factor = 0.150 / 0.066, dt = 1e-6, fastest[2] = {0, 0};
    assert_near(motion_pose(&deep, start, 1.5 * factor).position, v3(0.005, 0.003, -0.201 + 0.150));
    assert_near(motion_pose(&deep, start, deep.duration).position, start.position);
    assert_true(fabs(deep.duration - factor * insert->duration) < 1e-12);
    for (double t = 0; t < deep.duration; t += 1e-3) {
        const motion *both[] = {insert, &deep};
        for (int i = 0; i < 2; i++)
            fastest[i] = fmax(fastest[i], (motion_pose(both[i], start, t + dt).position.z - motion_pose(both[i], start, t).position.z) / dt);
    }
    assert_true(fabs(fastest[1] / fastest[0] - 1) < 1e-4);
}

/* Without needle.start.depth in the scene, the scripts are unchanged. */
static void the_scenes_depth_is_the_scripts(void **state) {
    (void)state;
    trocar_scene *scene;
    double depth;
    trocar_error why;
    assert_int_equal(trocar_scene_create(&scene, &why), TROCAR_OK);
    assert_int_equal(trocar_scene_get_number(scene, "needle.start.depth", &depth, &why), TROCAR_OK);
    assert_true(depth == MOTION_DEPTH);
    trocar_scene_free(scene);
}

static void unknown_script_is_not_found(void **state) {
    (void)state;
    assert_null(motion_find("figure9"));
    assert_null(motion_at(-1));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(figure8_follows_the_paper),
        cmocka_unit_test(figure8_reaches_the_skin_early),
        cmocka_unit_test(leg_fraction_is_symmetric),
        cmocka_unit_test(all_scripts_are_smooth_and_return),
        cmocka_unit_test(roll_turns_about_the_needles_axis),
        cmocka_unit_test(shifts_are_along_the_axes_of_the_start),
        cmocka_unit_test(a_deeper_script_is_as_fast),
        cmocka_unit_test(the_scenes_depth_is_the_scripts),
        cmocka_unit_test(unknown_script_is_not_found),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
