/* Tests that a needle moved by rate commands stays within its limits, whatever the commands. */
#include "shared/rate_control.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "check.h"

static const pose HOME = {{0.01, -0.02, -0.2}, {1, 0, 0, 0}};
static const double DT = 1e-3;

static rate_control_state begin(void) {
    rate_control_state d;
    rate_control_begin(&d, HOME, HOME);
    return d;
}

static void run(rate_control_state *d, const rate_control_limits *l, rate_control_command c, double seconds) {
    for (int i = 0; i < (int)(seconds / DT + 0.5); i++) rate_control_step(d, l, c, DT);
}

/* The speed ramps up linearly and then stays constant, so the distance is v (t - ramp / 2), to within half a step. */
static void moves_along_the_axis_as_commanded(void **unused) {
    (void)unused;
    rate_control_limits l = rate_control_defaults(0.2);
    rate_control_state d = begin();
    run(&d, &l, (rate_control_command){.forward = 1}, 1.0);
    assert_close(d.base.position.z - HOME.position.z, l.max_speed * (1.0 - 0.5 * l.ramp), l.max_speed * DT);
    assert_close(d.base.position.x, HOME.position.x, 0);
    run(&d, &l, (rate_control_command){0}, l.ramp + DT);
    vec3 rest = d.base.position;
    run(&d, &l, (rate_control_command){0}, 0.1);
    assert_close_vector(d.base.position, rest, 0); /* without a command, the needle stays still */
}

/* The same commands have the same effect in the frame of a rotated home pose. */
static void moves_and_tilts_about_the_axes_of_home(void **unused) {
    (void)unused;
    rate_control_limits l = rate_control_defaults(0.2);
    rate_control_state d = begin(), other;
    pose turned = {{-0.03, 0.04, 0.1}, q_exp(v3(0.9, -0.5, 0.3))};
    rate_control_begin(&other, turned, turned);
    for (int i = 0; i < 4; i++) {
        rate_control_command c = {.forward = 1 - i, .right = 0.5 * i, .up = i % 2, .pitch = i, .yaw = 1 - 0.5 * i, .roll = 1};
        run(&d, &l, c, 0.5);
        run(&other, &l, c, 0.5);
        vec3 moved = q_rotate(turned.orientation, v3_sub(d.base.position, HOME.position));
        assert_close_vector(v3_sub(other.base.position, turned.position), moved, 1e-12);
        assert_close_vector(q_axis(other.base.orientation), q_rotate(turned.orientation, q_axis(d.base.orientation)), 1e-9);
    }
}

/* A needle tilted by 0.2 rad moves the way it points. Its displacements are the sine and cosine of the tilt times the distance, which the ramp shortens by
   speed times half the ramp's duration. */
static void goes_along_the_needle_if_asked(void **unused) {
    (void)unused;
    rate_control_limits l = rate_control_defaults(0.2);
    l.along_needle = true;
    rate_control_state d;
    rate_control_begin(&d, HOME, (pose){HOME.position, q_exp(v3(0, 0.2, 0))});
    run(&d, &l, (rate_control_command){.forward = 1}, 0.5);
    double way = l.max_speed * (0.5 - 0.5 * l.ramp);
    assert_close_vector(v3_sub(d.base.position, HOME.position), v3(way * sin(0.2), 0, way * cos(0.2)), l.max_speed * DT);
    run(&d, &l, (rate_control_command){.forward = 1}, 100); /* long enough to reach the first limit, lateral or forward */
    vec3 end = v3_sub(d.base.position, HOME.position);
    assert_true(fabs(end.x) <= l.max_sideways && end.z <= l.max_forward);
    assert_true(fabs(end.x) > 0.99 * l.max_sideways || end.z > 0.99 * l.max_forward);
    assert_close(end.x, end.z * tan(0.2), 1e-9);
}

static void no_command_exceeds_a_limit(void **unused) {
    (void)unused;
    rate_control_limits l = rate_control_defaults(0.2);
    rate_control_state d = begin();
    uint32_t random = 7;
    for (int i = 0; i < 200000; i++) {
        double c[6];
        for (int k = 0; k < 6; k++) {
            random = 1664525u * random + 1013904223u;
            c[k] = 1e-8 * (double)random - 20.0;
            if (random % 97 == 0) c[k] = NAN;
            if (random % 89 == 0) c[k] = INFINITY;
        }
        pose before = d.base;
        rate_control_step(&d, &l, (rate_control_command){c[0], c[1], c[2], c[3], c[4], c[5]}, DT);
        vec3 moved = v3_sub(d.base.position, before.position), from_home = v3_sub(d.base.position, HOME.position);
        assert_true(fabs(moved.z) <= l.max_speed * DT * 1.0001 && fabs(moved.x) <= 0.5 * l.max_speed * DT * 1.0001);
        assert_true(fabs(from_home.x) <= l.max_sideways + 1e-12 && fabs(from_home.y) <= l.max_sideways + 1e-12);
        assert_true(from_home.z <= l.max_forward + 1e-12 && from_home.z >= -l.max_back - 1e-12);
        vec3 turned = q_log(q_multiply(d.base.orientation, q_conjugate(before.orientation)));
        assert_true(v3_norm(turned) <= 3 * l.max_turn_rate * DT);
        assert_true(acos(fmin(1, q_rotate(d.base.orientation, v3(0, 0, 1)).z)) <= l.max_tilt + 1e-9);
        double norm = d.base.orientation.w * d.base.orientation.w + v3_dot(v3(d.base.orientation.x, d.base.orientation.y, d.base.orientation.z),
                                                                           v3(d.base.orientation.x, d.base.orientation.y, d.base.orientation.z));
        assert_close(norm, 1, 1e-12);
    }
}

static void tilts_about_world_axes_and_rolls_about_its_own(void **unused) {
    (void)unused;
    rate_control_limits l = rate_control_defaults(0.2);
    rate_control_state d = begin();
    run(&d, &l, (rate_control_command){.yaw = 1}, 0.4);
    vec3 axis = q_rotate(d.base.orientation, v3(0, 0, 1));
    assert_true(axis.x > 0.1 && fabs(axis.y) < 1e-12);
    run(&d, &l, (rate_control_command){0}, 0.5);
    axis = q_rotate(d.base.orientation, v3(0, 0, 1));
    run(&d, &l, (rate_control_command){.roll = 1}, 1.0);
    assert_close_vector(q_rotate(d.base.orientation, v3(0, 0, 1)), axis, 1e-12);
    assert_true(v3_dot(q_rotate(d.base.orientation, v3(0, 1, 0)), v3(0, 1, 0)) < 0.7);
}

/* A needle taken over from another device outside the workspace may only move back toward it. */
static void from_outside_it_can_only_move_back(void **unused) {
    (void)unused;
    rate_control_limits l = rate_control_defaults(0.2);
    pose far = HOME;
    far.position.x += l.max_sideways + 0.01;
    rate_control_state d;
    rate_control_begin(&d, HOME, far);
    run(&d, &l, (rate_control_command){.right = 1}, 0.5);
    assert_close(d.base.position.x, far.position.x, 0);
    run(&d, &l, (rate_control_command){.right = -1}, 1.0);
    assert_true(d.base.position.x < far.position.x - 0.01);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(moves_along_the_axis_as_commanded),
        cmocka_unit_test(moves_and_tilts_about_the_axes_of_home),
        cmocka_unit_test(goes_along_the_needle_if_asked),
        cmocka_unit_test(no_command_exceeds_a_limit),
        cmocka_unit_test(tilts_about_world_axes_and_rolls_about_its_own),
        cmocka_unit_test(from_outside_it_can_only_move_back),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
