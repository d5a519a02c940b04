#include "device/hand.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <cmocka.h>

/* Integrates a reference solution with the classical Runge-Kutta method, in steps so small that the error is far below the tolerance. */
static void integrate(hand *h, vec3 target, vec3 force, double time, int steps) {
    double dt = time / steps;
    for (int i = 0; i < steps; i++) {
        vec3 dx[4], dv[4], x = h->position, v = h->velocity;
        for (int k = 0; k < 4; k++) {
            double ahead = k == 0 ? 0 : k == 3 ? dt : 0.5 * dt;
            vec3 xk = k ? v3_axpy(ahead, dx[k - 1], x) : x, vk = k ? v3_axpy(ahead, dv[k - 1], v) : v;
            vec3 pull = v3_sub(v3_scale(h->stiffness, v3_sub(target, xk)), v3_scale(h->damping, vk));
            dx[k] = vk;
            dv[k] = v3_scale(1 / h->mass, v3_add(pull, force));
        }
        for (int k = 0; k < 4; k++) {
            double weight = dt * (k == 0 || k == 3 ? 1.0 : 2.0) / 6;
            h->position = v3_axpy(weight, dx[k], h->position);
            h->velocity = v3_axpy(weight, dv[k], h->velocity);
        }
    }
}

static void assert_same_path(double damping) {
    hand exact = {0.5, damping, 200, {0.01, -0.02, 0}, {0, 0.1, 0.3}}, fine = exact;
    vec3 target = v3(0.02, 0, -0.01), force = v3(0, -3, 1);
    for (int i = 0; i < 10; i++) {
        hand_step(&exact, target, force, 0.037);
        integrate(&fine, target, force, 0.037, 2000);
        assert_true(v3_norm(v3_sub(exact.position, fine.position)) < 1e-10);
        assert_true(v3_norm(v3_sub(exact.velocity, fine.velocity)) < 1e-8);
    }
}

static void follows_the_equation_of_motion(void **state) {
    (void)state;
    assert_same_path(0);
    assert_same_path(4);    /* underdamped */
    assert_same_path(20);   /* critical damping: c^2 = 4 m k */
    assert_same_path(20.0000001);
    assert_same_path(80);   /* overdamped */
}

static void undamped_hand_oscillates_at_its_natural_frequency(void **state) {
    (void)state;
    hand h = {2, 0, 50, {0.01, 0, 0}, {0, 0, 0}};   /* 5 rad/s */
    double period = 2 * acos(-1) / 5;
    for (int i = 0; i < 1000; i++) hand_step(&h, v3(0, 0, 0), v3(0, 0, 0), period / 1000);
    assert_true(fabs(h.position.x - 0.01) < 1e-12 && fabs(h.velocity.x) < 1e-11);
}

static void comes_to_rest_where_spring_and_force_balance(void **state) {
    (void)state;
    hand h = {0.3, 6, 400, {0, 0, 0}, {0, 0, 0}};
    for (int i = 0; i < 100; i++) hand_step(&h, v3(0, 0, 0.1), v3(0, 0, -4), 0.1);
    assert_true(fabs(h.position.z - 0.09) < 1e-12);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(follows_the_equation_of_motion),
        cmocka_unit_test(undamped_hand_oscillates_at_its_natural_frequency),
        cmocka_unit_test(comes_to_rest_where_spring_and_force_balance),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
