/* Tests trocar-haply's force limits: maximum force, rate, ramps, and rejection of values that are not finite. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "check.h"
#include "limiter.h"

static const double PERIOD = 1e-3; /* s */
static const vec3 NONE = {0, 0, 0};

static limiter make(double max_force, double max_rate) { return (limiter){.max_force = max_force, .max_rate = max_rate}; }

/* Requests a constant force for `seconds`. Every step must stay within both limits. */
static vec3 hold(limiter *l, vec3 felt, vec3 carried, double seconds) {
    vec3 last = l->force;
    for (int k = 0; k < lround(seconds / PERIOD); k++) {
        vec3 force = limiter_next(l, felt, carried, PERIOD);
        assert_true(v3_norm(force) <= l->max_force * (1 + 1e-12));
        assert_true(v3_norm(v3_sub(force, last)) <= l->max_rate * PERIOD * (1 + 1e-9));
        last = force;
    }
    return last;
}

static void force_rises_in_a_tenth_of_a_second(void **state) {
    (void)state;
    limiter l = make(10, 1e5);
    assert_close(hold(&l, v3(0, -2, 0), NONE, 0.04).y, -2 * 0.4 * 0.4, 1e-9); /* both gains apply: the gain after an interruption, and that of the grip */
    assert_close(hold(&l, v3(0, -2, 0), NONE, 0.07).y, -2, 1e-12);
}

static void force_and_rate_are_limited(void **state) {
    (void)state;
    limiter l = make(3, 50);
    vec3 force = hold(&l, v3(30, 0, -40), NONE, 1);
    assert_close(force.x, 1.8, 1e-9); /* the direction is unchanged */
    assert_close(force.z, -2.4, 1e-9);
    force = hold(&l, v3(-30, 0, 40), NONE, 0.06);
    assert_close(v3_norm(force), 0, 1e-9); /* half-way from 3 N to -3 N, at 50 N/s */
    assert_close(limiter_next(&l, v3(-300, 0, 0), NONE, 5).x, -50 * 0.01, 1e-9); /* a late call does not allow a larger change */
}

static void a_cut_is_immediate(void **state) {
    (void)state;
    limiter l = make(3, 50);
    hold(&l, v3(3, 0, 0), NONE, 1);
    limiter_cut(&l);
    assert_true(v3_norm(l.force) == 0);
    assert_true(hold(&l, v3(3, 0, 0), NONE, 0.01).x < 0.1);
}

static void what_is_not_finite_gives_no_force(void **state) {
    (void)state;
    const double wrong[] = {NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 3; i++) {
        limiter l = make(3, 1e5);
        hold(&l, v3(1, 0, 0), NONE, 1);
        assert_true(v3_norm(limiter_next(&l, v3(0, wrong[i], 0), NONE, PERIOD)) == 0);
        hold(&l, v3(1, 0, 0), NONE, 1);
        assert_true(v3_norm(limiter_next(&l, v3(1, 0, 0), NONE, i == 0 ? NAN : -1.0)) == 0);
        assert_close(hold(&l, v3(1, 0, 0), NONE, 1).x, 1, 1e-12); /* the force recovers afterwards */
    }
}

static void a_weight_is_carried_without_the_needle(void **state) {
    (void)state;
    limiter l = make(3, 400);
    vec3 weight = v3(0, 0, 0.5), force = hold(&l, v3(1, 0, 0), weight, 1);
    assert_close(force.x, 1, 1e-12);
    for (int k = 0; k < 50; k++) {
        limiter_let_go(&l);
        force = limiter_next(&l, NONE, weight, PERIOD);
        assert_close(force.z, 0.5, 1e-12);
    }
    assert_close(force.x, 0, 1e-12);
    assert_close(hold(&l, v3(1, 0, 0), weight, 0.049).x, 0.5, 1e-9); /* 0.05 s after the last release */
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(force_rises_in_a_tenth_of_a_second), cmocka_unit_test(force_and_rate_are_limited),
        cmocka_unit_test(a_cut_is_immediate), cmocka_unit_test(what_is_not_finite_gives_no_force),
        cmocka_unit_test(a_weight_is_carried_without_the_needle),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
