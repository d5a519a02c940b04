/* Tests the safety limits tick by tick, with a simulated clock. */
#include <stdio.h>
#include <string.h>

#include "intake/safety_limits.h"
#include "scene/device.h"
#include "trocar_needle_wrench_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static const double DT = 1e-3;
enum { MILLISECOND = 1000000 };

static pose at(double x) { return (pose){{x, 0, 0}, {1, 0, 0, 0}}; }

static pose_sample sample(uint64_t engagement, double x, int64_t received) {
    return (pose_sample){.held = true, .engagement = engagement, .session = 1, .received = received, .base = at(x)};
}

/* Runs one tick in which the model returns a constant wrench. Returns the flags. */
static int tick(safety_limits *g, const device_limits *limits, bool wind_down, double model_force, vec3 *force) {
    vec3 torque = v3(0, 0, 0);
    *force = v3(model_force, 0, 0);
    return safety_wrench(g, limits, wind_down, DT, force, &torque);
}

/* Returns the safety state after one second at full wrench with a pose at x = 0. The last pose arrived at `now`. */
static safety_limits engaged(const device_limits *limits, int64_t now, double model_force) {
    safety_limits g = {0};
    vec3 force;
    pose_sample s = sample(1, 0, now);
    assert_int_equal(safety_pose(&g, limits, &s, now), SAFETY_ENGAGE);
    for (int i = 0; i < 1000; i++) tick(&g, limits, false, model_force, &force);
    assert_int_equal(safety_pose(&g, limits, &s, now), SAFETY_FOLLOW);
    assert_true(g.gain == 1.0);
    return g;
}

static void bad_numbers_are_reported(void **unused) {
    (void)unused;
    pose p = at(0);
    assert_int_equal(safety_check_pose(&p), POSE_ACCEPTED);
    p.position.y = NAN;
    assert_int_equal(safety_check_pose(&p), POSE_NOT_FINITE);
    p = at(INFINITY);
    assert_int_equal(safety_check_pose(&p), POSE_NOT_FINITE);
    p = at(0);
    p.orientation.z = NAN;
    assert_int_equal(safety_check_pose(&p), POSE_NOT_FINITE);
    p.orientation = (quat){1.002, 0, 0, 0};
    assert_int_equal(safety_check_pose(&p), POSE_NOT_UNIT);
    p.orientation = (quat){0, 0, 0, 0};
    assert_int_equal(safety_check_pose(&p), POSE_NOT_UNIT);
    p.orientation = (quat){0, 0, -0.9995, 0};
    assert_int_equal(safety_check_pose(&p), POSE_ACCEPTED);
}

static void travel_time_is_the_longer_of_translation_and_rotation(void **unused) {
    (void)unused;
    device_limits limits = device_defaults(); /* default limits: 2 m/s and 20 rad/s */
    pose a = at(0), b = at(0.5);
    assert_true(fabs(safety_travel_time(&limits, &a, &b) - 0.25) < 1e-12);
    b.orientation = (quat){cos(5.0 / 20), 0, sin(5.0 / 20), 0}; /* a rotation by 0.5 rad, which takes 25 ms */
    assert_true(fabs(safety_travel_time(&limits, &a, &b) - 0.25) < 1e-12);
    b.position.x = 0;
    assert_true(fabs(safety_travel_time(&limits, &a, &b) - 0.025) < 1e-12);
    b.orientation = (quat){-1, 0, 0, 0}; /* the same orientation */
    assert_true(safety_travel_time(&limits, &a, &b) < 1e-12);
}

static void nothing_happens_before_the_first_pose(void **unused) {
    (void)unused;
    device_limits limits = device_defaults();
    safety_limits g = {0};
    pose_sample none = {0};
    vec3 force;
    assert_int_equal(safety_pose(&g, &limits, &none, 5 * MILLISECOND), SAFETY_IDLE);
    assert_int_equal(tick(&g, &limits, false, 3.0, &force), 0);
    assert_true(force.x == 0.0 && safety_at_rest(&g));
}

static void engaging_ramps_in_over_the_ramp_time(void **unused) {
    (void)unused;
    device_limits limits = device_defaults(); /* default ramp: 100 ms */
    safety_limits g = {0};
    vec3 force;
    pose_sample s = sample(1, 0, 0);
    assert_int_equal(safety_pose(&g, &limits, &s, 0), SAFETY_ENGAGE);
    for (int i = 1; i <= 100; i++) {
        assert_true(tick(&g, &limits, false, 10.0, &force) & TROCAR_NEEDLE_WRENCH_T_RAMPING);
        assert_true(fabs(force.x - 0.1 * i) < 1e-9);
    }
    assert_int_equal(tick(&g, &limits, false, 10.0, &force), 0);
    assert_true(fabs(force.x - 10.0) < 1e-9);
}

static void stale_poses_hold_then_ramp_then_return(void **unused) {
    (void)unused;
    device_limits limits = device_defaults(); /* defaults: 10 ms hold time, 100 ms ramp */
    safety_limits g = engaged(&limits, 0, 10.0);
    pose_sample s = sample(1, 0, 0);
    vec3 force;
    for (int ms = 1; ms <= 10; ms++) {
        assert_int_equal(safety_pose(&g, &limits, &s, ms * (int64_t)MILLISECOND), SAFETY_FOLLOW);
        assert_int_equal(tick(&g, &limits, false, 10.0, &force), 0);
        assert_true(fabs(force.x - 10.0) < 1e-9);
    }
    for (int ms = 11; ms <= 111; ms++) {
        assert_int_equal(safety_pose(&g, &limits, &s, ms * (int64_t)MILLISECOND), SAFETY_HOLD);
        assert_true(tick(&g, &limits, false, 10.0, &force) & TROCAR_NEEDLE_WRENCH_T_STALE);
    }
    assert_true(force.x == 0.0);
    s = sample(1, 0.01, 120 * (int64_t)MILLISECOND); /* a pose after a gap, 10 mm further on, within the limits */
    assert_int_equal(safety_pose(&g, &limits, &s, 121 * (int64_t)MILLISECOND), SAFETY_FOLLOW);
    assert_true(g.base.position.x == 0.01);
    assert_int_equal(tick(&g, &limits, false, 10.0, &force), TROCAR_NEEDLE_WRENCH_T_RAMPING);
    assert_true(force.x > 0.0 && force.x < 0.2);
}

static void return_from_far_away_engages_again(void **unused) {
    (void)unused;
    device_limits limits = device_defaults();
    safety_limits g = engaged(&limits, 0, 10.0);
    pose_sample s = sample(1, 0, 0);
    safety_pose(&g, &limits, &s, 150 * (int64_t)MILLISECOND);
    s = sample(1, 0.31, 150 * (int64_t)MILLISECOND); /* a jump of 0.31 m in 0.15 s, which exceeds 2 m/s */
    assert_int_equal(safety_pose(&g, &limits, &s, 151 * (int64_t)MILLISECOND), SAFETY_ENGAGE);
    assert_true(g.base.position.x == 0.31 && g.gain == 0.0);
}

static void new_engagement_restarts_and_release_ramps_out(void **unused) {
    (void)unused;
    device_limits limits = device_defaults();
    safety_limits g = engaged(&limits, 0, 10.0);
    pose_sample s = sample(1, 0, 0);
    vec3 force;
    s.held = false;
    for (int ms = 0; ms < 101; ms++) {
        assert_int_equal(safety_pose(&g, &limits, &s, ms * (int64_t)MILLISECOND), SAFETY_HOLD);
        tick(&g, &limits, false, 10.0, &force);
    }
    assert_true(safety_at_rest(&g));
    s = sample(2, 5.0, 200 * (int64_t)MILLISECOND);
    assert_int_equal(safety_pose(&g, &limits, &s, 200 * (int64_t)MILLISECOND), SAFETY_ENGAGE);
    assert_true(g.base.position.x == 5.0);
}

static void limits_preserve_the_direction(void **unused) {
    (void)unused;
    device_limits limits = device_defaults();
    limits.max_force_rate = limits.max_torque_rate = 1e9;
    safety_limits g = engaged(&limits, 0, 0.0);
    vec3 force = v3(30, -40, 0), torque = v3(0, 0, 7);
    assert_int_equal(safety_wrench(&g, &limits, false, DT, &force, &torque), TROCAR_NEEDLE_WRENCH_T_SATURATED);
    assert_true(fabs(force.x - 12) < 1e-12 && fabs(force.y + 16) < 1e-12 && force.z == 0); /* 20 N */
    assert_true(fabs(torque.z - 1.0) < 1e-12);
}

/* At the profile's force rate, full force is reached in 3 ms. A profile of a device without torque leaves the torque limits unchanged. */
static void profile_sets_the_limits_of_its_device(void **unused) {
    (void)unused;
    device_limits limits = device_defaults(), before = limits;
    assert_false(device_use_profile("nonsense", &limits));
    assert_memory_equal(&limits, &before, sizeof limits);
    assert_true(device_use_profile("touch", &limits));
    assert_true(limits.max_force == 3.3 && limits.max_stiffness == 400);
    assert_true(fabs(limits.max_force_rate - 1100) < 1e-9);
    assert_true(limits.max_torque == before.max_torque && limits.max_torque_rate == before.max_torque_rate);
    assert_true(device_use_profile("delta.6", &limits));
    assert_true(fabs(limits.max_force_rate - 20 / 3e-3) < 1e-9);
    assert_true(limits.max_torque == 0.2 && fabs(limits.max_torque_rate - 0.2 / 3e-3) < 1e-9);
    assert_true(limits.max_speed == before.max_speed && limits.ramp_time == before.ramp_time);
    assert_true(limits.mass == before.mass && limits.delay == before.delay);

    safety_limits g = engaged(&limits, 0, 0.0);
    vec3 force;
    assert_int_equal(tick(&g, &limits, false, 40.0, &force), TROCAR_NEEDLE_WRENCH_T_SATURATED);
    assert_true(fabs(force.x - 20 / 3.0) < 1e-9);
    for (int i = 0; i < 3; i++) tick(&g, &limits, false, 40.0, &force);
    assert_true(fabs(force.x - 20) < 1e-9);
}

/* Reads a row of meshes/parameters/devices.csv: device name, force (N), torque (N m), stiffness (N/mm), workspace (mm). */
static bool read_device(const char *line, char name[64], double v[6]) {
    return sscanf(line, "%63[^,],%lf,%lf,%lf,%lf x %lf x %lf,", name, &v[0], &v[1], &v[2], &v[3], &v[4], &v[5]) == 7;
}

static void documented_device_table_is_correct(void **unused) {
    (void)unused;
    char line[1024], name[64];
    double values[6];
    int count = 0, listed = 0;
    FILE *table = fopen(MESHES "/parameters/devices.csv", "r");
    assert_non_null(table);
    while (fgets(line, sizeof line, table)) {
        if (!read_device(line, name, values)) continue;
        device_limits limits = device_defaults();
        if (!device_use_profile(name, &limits)) fail_msg("devices.csv: no device %s", name);
        double torque = values[1] > 0 ? values[1] : device_defaults().max_torque;
        bool same = limits.max_force == values[0] && limits.max_torque == torque && fabs(limits.max_stiffness - 1e3 * values[2]) < 1e-9;
        vec3 workspace = v3(1e-3 * values[3], 1e-3 * values[4], 1e-3 * values[5]);
        if (v3_norm(v3_sub(device_workspace(name), workspace)) > 1e-9) fail_msg("devices.csv: %s has another workspace", name);
        if (!same) fail_msg("devices.csv: %s has %g N, %g N m, %g N/m", name, limits.max_force, limits.max_torque, limits.max_stiffness);
        count++;
    }
    fclose(table);
    while (device_profiles[listed]) listed++;
    assert_int_equal(count, listed);
}

static void slew_is_limited(void **unused) {
    (void)unused;
    device_limits limits = device_defaults(); /* default force rate: 2000 N/s, i.e. 2 N per tick */
    safety_limits g = engaged(&limits, 0, 0.0);
    vec3 force;
    for (int i = 1; i <= 5; i++) {
        assert_int_equal(tick(&g, &limits, false, 11.0, &force), TROCAR_NEEDLE_WRENCH_T_SATURATED);
        assert_true(fabs(force.x - 2.0 * i) < 1e-12);
    }
    assert_int_equal(tick(&g, &limits, false, 11.0, &force), 0);
    assert_true(fabs(force.x - 11.0) < 1e-12);
    vec3 torque = v3(0, 0.5, 0); /* default torque rate: 100 N m/s, i.e. 0.1 N m per tick */
    force = v3(11, 0, 0);
    assert_int_equal(safety_wrench(&g, &limits, false, DT, &force, &torque), TROCAR_NEEDLE_WRENCH_T_SATURATED);
    assert_true(fabs(torque.y - 0.1) < 1e-12);
}

static void non_finite_wrench_is_never_sent(void **unused) {
    (void)unused;
    device_limits limits = device_defaults();
    safety_limits g = engaged(&limits, 0, 3.0);
    vec3 force = v3(0, 0, 0), torque = v3(0, 0, 0);
    for (int i = 0; i < 10; i++) {
        force = v3(3, NAN, 0);
        torque = v3(0, 0, INFINITY);
        int flags = safety_wrench(&g, &limits, false, DT, &force, &torque);
        assert_true(flags & TROCAR_NEEDLE_WRENCH_T_UNSTABLE);
        assert_true(isfinite(force.x) && isfinite(force.y) && isfinite(torque.z));
    }
    assert_true(v3_norm(force) == 0.0);
}

static void overruns_in_a_row_ramp_out_until_timing_is_good(void **unused) {
    (void)unused;
    device_limits limits = device_defaults();
    safety_limits g = engaged(&limits, 0, 10.0);
    vec3 force;
    for (int i = 0; i < SAFETY_OVERRUNS - 1; i++) safety_timing(&g, true, DT);
    safety_timing(&g, false, DT); /* one punctual tick ends the run of late ones */
    for (int i = 0; i < SAFETY_OVERRUNS - 1; i++) safety_timing(&g, true, DT);
    assert_int_equal(tick(&g, &limits, false, 10.0, &force), 0);
    safety_timing(&g, true, DT);
    for (int i = 0; i < 101; i++) assert_true(tick(&g, &limits, false, 10.0, &force) & TROCAR_NEEDLE_WRENCH_T_OVERRUN);
    assert_true(safety_at_rest(&g));
    for (int i = 0; i < 998; i++) safety_timing(&g, false, DT);
    assert_true(tick(&g, &limits, false, 10.0, &force) & TROCAR_NEEDLE_WRENCH_T_OVERRUN);
    for (int i = 0; i < 4; i++) safety_timing(&g, false, DT);
    assert_int_equal(tick(&g, &limits, false, 10.0, &force), TROCAR_NEEDLE_WRENCH_T_RAMPING);
}

static void winding_down_comes_to_rest(void **unused) {
    (void)unused;
    device_limits limits = device_defaults();
    safety_limits g = engaged(&limits, 0, 10.0);
    vec3 force;
    int ticks = 0;
    while (!safety_at_rest(&g) && ticks < 1000) {
        tick(&g, &limits, true, 10.0, &force);
        ticks++;
    }
    assert_in_range(ticks, 100, 102);
}

/* After a transfer, the output ramps from its last value to the model's wrench and stays between the two, however the model's wrench changes. */
static void a_transfer_goes_over_by_a_ramp(void **unused) {
    (void)unused;
    device_limits limits = device_defaults();
    const double after[] = {3.0, 0.0, -1.0};
    for (int k = 0; k < 3; k++) {
        safety_limits g = engaged(&limits, 0, 1.0);
        vec3 force;
        double last = 1.0, most = fmax(1.0, after[k]), least = fmin(1.0, after[k]);
        int ticks = 0, flags;
        safety_begin_transfer(&g);
        do {
            flags = tick(&g, &limits, false, after[k], &force);
            assert_true(force.x <= most && force.x >= least && fabs(force.x - last) < 0.011 * fabs(after[k] - 1.0) + 1e-12);
            last = force.x;
            ticks++;
        } while (flags & TROCAR_NEEDLE_WRENCH_T_RAMPING);
        assert_in_range(ticks, 100, 102);
        assert_true(force.x == after[k] && flags == 0);
    }
}

/* A hand that engages the same needle again keeps its force during the ramp. Another hand starts without that force. */
static void a_new_hand_does_not_get_the_force_of_the_last_one(void **unused) {
    (void)unused;
    device_limits limits = device_defaults();
    for (int other = 0; other < 2; other++) {
        safety_limits g = engaged(&limits, 0, 1.0);
        pose_sample next = sample(2, 0.5, MILLISECOND);
        next.session += other;
        vec3 force;
        assert_int_equal(safety_pose(&g, &limits, &next, MILLISECOND), SAFETY_ENGAGE);
        tick(&g, &limits, false, 0.0, &force);
        assert_true(other ? force.x == 0.0 : force.x > 0.98);
        tick(&g, &limits, true, 0.0, &force);
        for (int i = 0; i < 110; i++) tick(&g, &limits, true, 0.0, &force);
        assert_true(safety_at_rest(&g));
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bad_numbers_are_reported),
        cmocka_unit_test(travel_time_is_the_longer_of_translation_and_rotation),
        cmocka_unit_test(nothing_happens_before_the_first_pose),
        cmocka_unit_test(engaging_ramps_in_over_the_ramp_time),
        cmocka_unit_test(stale_poses_hold_then_ramp_then_return),
        cmocka_unit_test(return_from_far_away_engages_again),
        cmocka_unit_test(new_engagement_restarts_and_release_ramps_out),
        cmocka_unit_test(limits_preserve_the_direction),
        cmocka_unit_test(profile_sets_the_limits_of_its_device),
        cmocka_unit_test(documented_device_table_is_correct),
        cmocka_unit_test(slew_is_limited),
        cmocka_unit_test(non_finite_wrench_is_never_sent),
        cmocka_unit_test(overruns_in_a_row_ramp_out_until_timing_is_good),
        cmocka_unit_test(winding_down_comes_to_rest),
        cmocka_unit_test(a_transfer_goes_over_by_a_ramp),
        cmocka_unit_test(a_new_hand_does_not_get_the_force_of_the_last_one),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
