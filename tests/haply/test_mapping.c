/* Tests trocar-haply's workspace: axes, scale, base or tip, orientation of the handle, the clutch, and transforming the force back to the device. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "check.h"
#include "mapping.h"

static const quat IDENTITY = {1, 0, 0, 0};
static const double DEGREE = M_PI / 180;

static mapping_settings standard(void) {
    return (mapping_settings){.rotation = MAPPING_Y_TO_Z, .scale = 1, .start = {0.1, 0.2, 0.3}, .length = 0.2, .direction = {0, 0, 1}, .tool = MAPPING_Y_TO_Z};
}

static mapping make(mapping_settings settings) {
    mapping m;
    mapping_init(&m, &settings);
    return m;
}

#define assert_vector(v, x, y, z) assert_close_vector(v, v3(x, y, z), 1e-9)

static void assert_same(pose p, pose expected) {
    vec3 e = expected.position;
    assert_vector(p.position, e.x, e.y, e.z);
    assert_true(v3_norm(q_log(q_multiply(p.orientation, q_conjugate(expected.orientation)))) < 1e-9);
}

/* Returns the rotation about one of the device's axes. */
static quat turn(double x, double y, double z, double degrees) { return q_exp(v3_scale(degrees * DEGREE, v3(x, y, z))); }

static void forward_is_into_the_body_and_up_is_up(void **state) {
    (void)state;
    mapping_settings s = standard();
    s.scale = 2;
    mapping m = make(s);
    assert_vector(mapping_pose(&m, v3(0.01, 0.02, 0.03), &IDENTITY, false).position, 0.1, 0.2, 0.3);
    assert_vector(mapping_pose(&m, v3(0.01, 0.03, 0.03), &IDENTITY, false).position, 0.1, 0.2, 0.32);
    assert_vector(mapping_pose(&m, v3(0.01, 0.02, 0.04), &IDENTITY, false).position, 0.1, 0.22, 0.3);
    assert_vector(mapping_pose(&m, v3(0.02, 0.02, 0.03), &IDENTITY, false).position, 0.08, 0.2, 0.3);
}

static void an_offset_is_where_the_origin_is(void **state) {
    (void)state;
    mapping_settings s = standard();
    s.has_offset = true;
    s.offset = v3(0, 0, -0.3);
    mapping m = make(s);
    assert_vector(mapping_pose(&m, v3(0, 0.1, 0), &IDENTITY, false).position, 0, 0, -0.2);
}

static void the_needle_points_where_the_handle_points(void **state) {
    (void)state;
    mapping m = make(standard());
    quat q = mapping_pose(&m, v3(0, 0, 0), &IDENTITY, false).orientation;
    assert_vector(q_axis(q), 0, 0, 1);
    assert_vector(q_rotate(q, v3(0, 1, 0)), 0, 1, 0);
    quat left = turn(0, 0, 1, 30), up = turn(1, 0, 0, 30), rolled = turn(0, 1, 0, 90);
    assert_vector(q_axis(mapping_pose(&m, v3(0, 0, 0), &left, false).orientation), 0.5, 0, sqrt(0.75));
    assert_vector(q_axis(mapping_pose(&m, v3(0, 0, 0), &up, false).orientation), 0, 0.5, sqrt(0.75));
    q = mapping_pose(&m, v3(0, 0, 0), &rolled, false).orientation;
    assert_vector(q_axis(q), 0, 0, 1);
    assert_vector(q_rotate(q, v3(0, 1, 0)), -1, 0, 0); /* the top of the handle points to the device's right */
}

static void the_tip_stays_at_the_cursor(void **state) {
    (void)state;
    mapping_settings s = standard();
    s.tip = true;
    mapping m = make(s);
    for (int degrees = 0; degrees < 90; degrees += 15) {
        quat q = turn(1, 0, 0, degrees);
        pose base = mapping_pose(&m, v3(0, 0, 0), &q, false);
        assert_vector(v3_axpy(0.2, q_axis(base.orientation), base.position), 0.1, 0.2, 0.3);
    }
}

static void fixed_or_without_a_handle_the_direction_is_kept(void **state) {
    (void)state;
    const vec3 directions[] = {{0, 0, 1}, {0, 0, -1}, {1, 0, 0}, {0, -3, 0}, {1, 1, -1}};
    quat q = turn(1, 0, 0, 40);
    for (int i = 0; i < 5; i++) {
        mapping_settings s = standard();
        s.fixed = true;
        s.direction = directions[i];
        mapping m = make(s);
        vec3 d = v3_unit(directions[i]);
        assert_vector(q_axis(mapping_pose(&m, v3(0, 0, 0), &q, false).orientation), d.x, d.y, d.z);
        s.fixed = false;
        m = make(s);
        assert_vector(q_axis(mapping_pose(&m, v3(0, 0, 0), NULL, false).orientation), d.x, d.y, d.z);
    }
    mapping m = make(standard());
    pose with = mapping_pose(&m, v3(0, 0, 0), &q, false);
    assert_same(mapping_pose(&m, v3(0, 0, 0), NULL, false), with);
}

static void the_clutch_holds_and_lets_go_without_a_jump(void **state) {
    (void)state;
    for (int tip = 0; tip < 2; tip++) {
        mapping_settings s = standard();
        s.tip = tip;
        mapping m = make(s);
        quat first = turn(1, 0, 0, 10), other = turn(0, 0, 1, -25), further = q_multiply(turn(0, 0, 1, 5), other);
        mapping_pose(&m, v3(0, 0, 0), &first, false);
        pose pressed = mapping_pose(&m, v3(0, 0.05, 0), &first, true);
        assert_same(mapping_pose(&m, v3(0.03, 0.01, -0.02), &other, true), pressed);
        assert_same(mapping_pose(&m, v3(0.03, 0.01, -0.02), NULL, false), pressed); /* without a handle, the state of its button is unknown */
        assert_same(mapping_pose(&m, v3(0.04, 0.01, -0.02), &other, false), pressed);
        pose after = mapping_pose(&m, v3(0.04, 0.02, -0.02), &further, false);
        vec3 was = v3_axpy(tip * 0.2, q_axis(pressed.orientation), pressed.position), is = v3_axpy(tip * 0.2, q_axis(after.orientation), after.position);
        assert_vector(v3_sub(is, was), 0, 0, 0.01);
        vec3 turned = q_log(q_multiply(after.orientation, q_conjugate(pressed.orientation)));
        assert_vector(turned, 0, 5 * DEGREE, 0); /* the needle turns about the vertical axis, as the hand does */
    }
}

static void a_first_position_with_the_clutch_pressed_is_the_start(void **state) {
    (void)state;
    mapping m = make(standard());
    assert_vector(mapping_pose(&m, v3(0, 0, 0), &IDENTITY, true).position, 0.1, 0.2, 0.3);
    assert_vector(mapping_pose(&m, v3(0, 0.1, 0), &IDENTITY, true).position, 0.1, 0.2, 0.3);
    assert_vector(mapping_pose(&m, v3(0, 0.1, 0), &IDENTITY, false).position, 0.1, 0.2, 0.3);
}

/* At scale 1, the hand does the same work as the needle. */
static void the_force_returns_in_the_devices_frame(void **state) {
    (void)state;
    mapping_settings s = standard();
    s.rotation = q_unit((quat){1, 2, -3, 0.5});
    mapping m = make(s);
    vec3 force = v3(0.3, -2, 0.7), motion = v3(0.01, 0.002, -0.03);
    pose before = mapping_pose(&m, v3(0, 0, 0), &IDENTITY, false), after = mapping_pose(&m, motion, &IDENTITY, false);
    assert_true(fabs(v3_dot(mapping_force(&m, force), motion) - v3_dot(force, v3_sub(after.position, before.position))) < 1e-12);
    m = make(standard());
    assert_vector(mapping_force(&m, v3(0, 0, -1)), 0, -1, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(forward_is_into_the_body_and_up_is_up), cmocka_unit_test(an_offset_is_where_the_origin_is),
        cmocka_unit_test(the_needle_points_where_the_handle_points), cmocka_unit_test(the_tip_stays_at_the_cursor),
        cmocka_unit_test(fixed_or_without_a_handle_the_direction_is_kept), cmocka_unit_test(the_clutch_holds_and_lets_go_without_a_jump),
        cmocka_unit_test(a_first_position_with_the_clutch_pressed_is_the_start), cmocka_unit_test(the_force_returns_in_the_devices_frame),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
