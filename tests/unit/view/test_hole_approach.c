/* Tests that a needle moves to the chosen hole by first backing out of the template and then going sideways, and never sideways inside the plate. */
#include "view/hand/hole_approach.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "check.h"

static const double DT = 1e-3, LENGTH = 0.2;

static trocar_guide template(void) {
    return (trocar_guide){.origin = {0, 0, -0.025}, .normal = {0, 0, 1}, .across = {{1, 0, 0}, {0, 1, 0}}, .spacing = 0.005, .columns = 13, .rows = 13,
                          .thickness = 0.02};
}

/* Hole C3.5 is 4 columns and 1 row away from the middle hole. */
static void waits_in_line_with_the_hole(void **unused) {
    (void)unused;
    trocar_guide g = template();
    pose home = hole_home(&g, 2, 5, LENGTH);
    vec3 tip = v3_axpy(LENGTH, q_axis(home.orientation), home.position);
    assert_close(tip.x, -0.020, 1e-15);
    assert_close(tip.y, -0.005, 1e-15);
    assert_true(tip.z < -0.025 && tip.z > -0.035);
    assert_close_vector(q_axis(home.orientation), v3(0, 0, 1), 1e-15);
}

/* If the template's letters run the other way, the hole is somewhere else. The needle itself is not rotated, so keys and bevel work as before. */
static void a_mirrored_template_does_not_turn_the_needle(void **unused) {
    (void)unused;
    trocar_guide g = template(), mirrored = template();
    mirrored.across[0][0] = -1;
    pose plain = hole_home(&g, 10, 5, LENGTH), home = hole_home(&mirrored, 2, 5, LENGTH);
    assert_close_vector(home.position, plain.position, 1e-15);
    for (int a = 0; a < 3; a++)
        assert_close_vector(q_rotate(home.orientation, v3(a == 0, a == 1, a == 2)), q_rotate(plain.orientation, v3(a == 0, a == 1, a == 2)), 1e-12);
}

/* The approach also works for a rotated template, with needles coming from the opposite side or at an angle. */
static void its_axes_are_those_of_the_template(void **unused) {
    (void)unused;
    for (int i = 0; i < 20; i++) {
        quat q = i == 0 ? (quat){0, 1, 0, 0} : q_exp(v3(0.3 * i, sin(i), cos(2 * i)));
        trocar_guide g = template();
        vec3 axes[3] = {q_rotate(q, v3(1, 0, 0)), q_rotate(q, v3(0, 1, 0)), q_axis(q)};
        for (int a = 0; a < 3; a++) {
            double *to = a < 2 ? g.across[a] : g.normal;
            to[0] = axes[a].x, to[1] = axes[a].y, to[2] = axes[a].z;
        }
        quat found = hole_home(&g, 6, 6, LENGTH).orientation;
        for (int a = 0; a < 3; a++) assert_close_vector(q_rotate(found, v3(a == 0, a == 1, a == 2)), axes[a], 1e-12);
    }
}

/* The tilted tip starts 30 mm beyond the template's face, and moves sideways only after it has been drawn back in front of it. */
static void leaves_the_template_before_it_moves_sideways(void **unused) {
    (void)unused;
    trocar_guide g = template();
    rate_control_limits l = rate_control_defaults(LENGTH);
    pose from = hole_home(&g, 6, 6, LENGTH);
    from.position.z += 0.033;
    rate_control_state d;
    rate_control_begin(&d, hole_home(&g, 2, 5, LENGTH), from);
    int steps = 0;
    for (vec3 before = from.position; !approach_step(&d, &l, DT); before = d.base.position) {
        vec3 moved = v3_sub(d.base.position, before);
        bool aside = hypot(moved.x, moved.y) > 1e-12;
        assert_true(v3_norm(moved) <= 2.0 * l.max_speed * DT * sqrt(2.0) + 1e-12);
        assert_true(!aside || d.base.position.z + LENGTH < -0.025);
        assert_true(++steps < 5000);
    }
    assert_close_vector(d.base.position, d.home.position, 0);
    assert_true(approach_step(&d, &l, DT)); /* the needle has arrived, and stays at the hole */
    assert_close_vector(d.base.position, d.home.position, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(waits_in_line_with_the_hole),
        cmocka_unit_test(a_mirrored_template_does_not_turn_the_needle),
        cmocka_unit_test(its_axes_are_those_of_the_template),
        cmocka_unit_test(leaves_the_template_before_it_moves_sideways),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
