/* Friction against turning: lag and torque against closed forms, and the bound shared with sliding. */
#include "insertion/roll.h"
#include "lockstep.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static const double DRY = 20.0; /* N/m, the same in all regions, static and kinetic */

static simulation_config scene_with(double dry, double viscous) {
    simulation_config c = lockstep_config();
    for (int i = 0; i < c.region_count; i++) {
        region_material *m = &c.regions[i].material;
        m->friction_static = m->friction_kinetic = dry;
        m->friction_viscous = viscous;
    }
    return c;
}

/* 60 mm deep, without force. */
static lockstep *engaged(const simulation_config *config) {
    pose start = lockstep_start();
    start.position.z += 0.061;
    lockstep *l = lockstep_create(config, start);
    for (int i = 0; i < 3; i++) lockstep_tick(l, start, 1e-6);
    assert_true(contacts_active(&l->state) > 5);
    return l;
}

static void turn(lockstep *l, double angle, double seconds) {
    int n = (int)(seconds * 1e3 + 0.5);
    pose from = l->base;
    for (int i = 1; i <= n; i++) lockstep_tick(l, (pose){from.position, q_unit(q_multiply(from.orientation, q_exp(v3(0, 0, angle * i / n))))}, 1e-3);
}

/* Turned far, all of the shaft slides round: the torque per length f = dry r twists it by f l^2 / 2 G J over the length l in the tissue, and
   evenly before it. */
static void check_lag(double sign) {
    simulation_config c = scene_with(DRY, 0.0);
    lockstep *l = engaged(&c);
    const needle_model *needle = &l->simulation.needle;
    turn(l, sign * 2.0, 2.0);
    double f = DRY * needle->radius, depth = l->state.tip.depth, before = needle->given.length - depth;
    double lag = f * (0.5 * depth * depth + depth * before) / needle->torsion;
    printf("lag %.6f, expected %.6f; torque %.6f of %.6f\n", -l->state.tip_lead, lag, l->wrench.torque.z, f * depth);
    assert_true(fabs(-sign * l->state.tip_lead / lag - 1.0) < 0.01);
    assert_true(fabs(-sign * l->wrench.torque.z / (f * depth) - 1.0) < 0.01);
    /* and back by as much and more: the same the other way */
    turn(l, -sign * 4.0, 4.0);
    assert_true(fabs(sign * l->state.tip_lead / lag - 1.0) < 0.01);
    lockstep_free(l);
}

static void tip_lags_by_the_twist_of_friction(void **unused) {
    (void)unused;
    check_lag(1.0);
    check_lag(-1.0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tip_lags_by_the_twist_of_friction),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
