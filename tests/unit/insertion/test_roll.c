/* Tests friction against turning: lag and torque are compared with closed forms, and sliding and turning share one friction limit. */
#include "insertion/contact/roll.h"
#include "insertion/tip/next_body.h"
#include "lockstep.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static const double DRY = 20.0; /* N/m, static and kinetic friction, the same in all regions */

static simulation_config scene_with(double dry, double viscous) {
    simulation_config c = lockstep_config();
    for (int i = 0; i < c.region_count; i++) {
        region_material *m = &c.regions[i].material;
        m->friction_static = m->friction_kinetic = dry;
        m->friction_viscous = viscous;
    }
    return c;
}

static lockstep *engaged(const simulation_config *config) {
    lockstep *l = lockstep_engaged(config);
    assert_true(contacts_active(&l->state) > 5);
    return l;
}

static void turn(lockstep *l, double angle, double seconds) {
    int n = (int)(seconds * 1e3 + 0.5);
    pose from = l->base;
    for (int i = 1; i <= n; i++) lockstep_tick(l, (pose){from.position, q_unit(q_multiply(from.orientation, q_exp(v3(0, 0, angle * i / n))))}, 1e-3);
}

/* Turns the base until the whole shaft slides around its axis. The torque per unit length, f = dry r, twists the shaft by f l^2 / 2 G J over the length l in
   the tissue. Outside the tissue, the twist is uniform. */
static void check_lag(double sign) {
    simulation_config c = scene_with(DRY, 0.0);
    lockstep *l = engaged(&c);
    const needle_model *needle = &l->parts.needle;
    turn(l, sign * 2.0, 2.0);
    double f = DRY * needle->radius, depth = l->state.tip.place.depth, before = needle->given.length - depth;
    double lag = f * (0.5 * depth * depth + depth * before) / needle->torsion;
    printf("lag %.6f, expected %.6f; torque %.6f of %.6f\n", -l->state.tip_lead, lag, l->wrench.torque.z, f * depth);
    assert_true(fabs(-sign * l->state.tip_lead / lag - 1.0) < 0.01);
    assert_true(fabs(-sign * l->wrench.torque.z / (f * depth) - 1.0) < 0.01);
    /* turning back by as much and further gives the same result in the other direction */
    turn(l, -sign * 4.0, 4.0);
    assert_true(fabs(sign * l->state.tip_lead / lag - 1.0) < 0.01);
    lockstep_free(l);
}

static void tip_lags_by_the_twist_of_friction(void **unused) {
    (void)unused;
    check_lag(1.0);
    check_lag(-1.0);
}

/* Withdraws the needle at constant speed while it turns. Friction opposes the slip of the shaft's surface. */
static double friction_while(double speed, double rate, double *torque) {
    simulation_config c = scene_with(DRY, 0.0);
    lockstep *l = engaged(&c);
    const int ticks = 1500;
    pose from = l->base;
    double per_metre = 0.0;
    for (int i = 1; i <= ticks; i++) {
        double t = i * 1e-3;
        lockstep_tick(l, (pose){v3_axpy(-speed * t, v3(0, 0, 1), from.position), q_exp(v3(0, 0, rate * t))}, 1e-3);
        per_metre = l->wrench.force.z / l->state.tip.place.depth;
        *torque = l->wrench.torque.z / l->state.tip.place.depth;
    }
    lockstep_free(l);
    return per_metre;
}

static void turning_eases_sliding(void **unused) {
    (void)unused;
    static const double rates[] = {0.0, 3.0, 10.0, 30.0}; /* rad/s */
    for (size_t i = 0; i < sizeof rates / sizeof *rates; i++) {
        double speed = 0.01, radius = 0.5 * 1.27e-3, torque, whole = hypot(speed, radius * rates[i]);
        double force = friction_while(speed, rates[i], &torque);
        printf("%g rad/s: %.4f N/m, expected %.4f; %.4g N, expected %.4g\n", rates[i], force, DRY * speed / whole, -torque, DRY * radius * radius * rates[i] / whole);
        assert_true(fabs(force / (DRY * speed / whole) - 1.0) < 0.01);
        if (rates[i] > 0.0) assert_true(fabs(-torque / (DRY * radius * radius * rates[i] / whole) - 1.0) < 0.01);
    }
}

static bool all_slides(const insertion_state *s) {
    if (s->tip.place.phase != TIP_INSIDE || s->tip.barrier.blocked_by != NOT_BLOCKED || s->tip.solved.friction != SLIP_FORWARD || s->tip.shaft.friction != SLIP_FORWARD) return false;
    for (int k = 0; contact_is_active(s, k); k++)
        if (s->contacts[s->refined.order[k]].shaft.friction != SLIP_FORWARD) return false;
    return true;
}

/* The needle is inserted from outside at constant speed while it turns, at several ratios of circumferential to axial speed. Friction is the same everywhere
   and the needle hardly twists, so the whole shaft slides in one direction. Along the needle, the base feels the cutting force and F v / sqrt(v^2 + (omega
   r)^2), where F is the friction without turning; around the needle, it feels the other component of F. Only ticks in which the tip cuts and the whole shaft
   slides are compared, leaving out the jump at a membrane. A new contact node starts as if the shaft did not turn (docs/mechanics.md). Until it slides, the
   force may be off by an amount too small to feel; once it slides, the formula holds in every tick. */
static void turning_eases_insertion(void **unused) {
    (void)unused;
    enum { TICKS = 3200, LEAP = 100, SETTLED = 50 };
    static const double ratios[] = {0.0, 0.5, 1.0, 2.0, 4.0}; /* ratio omega r / v of circumferential to axial speed */
    const double speed = 0.025, cutting = 0.4, least_depth = 0.02, unnoticed = 0.05; /* N */
    for (size_t i = 0; i < sizeof ratios / sizeof *ratios; i++) {
        simulation_config c = scene_with(DRY, 0.0);
        for (int k = 0; k < c.region_count; k++) c.regions[k].material.cutting_force = cutting, c.regions[k].material.cutting_viscosity = 0.0;
        lockstep *l = lockstep_create(&c, lockstep_start());
        double radius = l->parts.needle.radius, rate = ratios[i] * speed / radius, left = 1.0 / hypot(1.0, ratios[i]);
        double worst = 0.0, worst_torque = 0.0, new_contact = 0.0, sum = 0.0;
        int counted = 0, settled = 0, punctured = 0, added = 0; /* `punctured`, `added`: ticks since the last puncture and since the last node was added */
        for (int k = 1; k <= TICKS; k++) {
            double t = k * 1e-3;
            pose start = lockstep_start();
            lockstep_tick(l, (pose){v3_axpy(speed * t, v3(0, 0, 1), start.position), q_exp(v3(0, 0, rate * t))}, 1e-3);
            punctured = l->wrench.events & EVENT_PUNCTURED ? 0 : punctured + 1;
            added = l->wrench.events & EVENT_ADDED ? 0 : added + 1;
            if (l->wrench.depth < least_depth || punctured < LEAP || !all_slides(&l->state)) continue;
            double whole = DRY * l->wrench.depth, along = (-l->wrench.force.z - cutting) / whole, around = -l->wrench.torque.z / (whole * radius);
            sum += along;
            counted++;
            new_contact = fmax(new_contact, whole * hypot(along - left, around - ratios[i] * left));
            if (added < SETTLED) continue;
            worst = fmax(worst, fabs(along / left - 1.0));
            worst_torque = fmax(worst_torque, fabs(around - ratios[i] * left));
            settled++;
        }
        printf("omega r / v = %g: mean of %d ticks %.4f F, expected %.4f; worst of %d settled ticks %.4f of it, torque %.4f F r; after a new contact %.4f N\n",
               ratios[i], counted, sum / counted, left, settled, worst, worst_torque, new_contact);
        assert_true(settled > TICKS / 8);
        assert_true(fabs(sum / counted / left - 1.0) < 0.01);
        assert_true(worst < 0.02 && worst_torque < 0.02);
        assert_true(new_contact < unnoticed);
        lockstep_free(l);
    }
}

/* The segments turn with the base before the solve, so turning takes no more passes than sliding, even if the needle is bent. */
static void turning_takes_one_pass(void **unused) {
    (void)unused;
    enum { TICKS = 200 };
    simulation_config c = scene_with(DRY, 0.0);
    lockstep *l = engaged(&c);
    int sliding = 0, turning = 0;
    lockstep_move(l, v3(0.004, 0, 0), 0.2, 1e-3);
    for (int i = 0; i < 50; i++) lockstep_tick(l, l->base, 1e-3);
    for (int i = 0; i < TICKS; i++) {
        lockstep_move(l, v3(0, 0, -1e-5), 1e-3, 1e-3);
        sliding += l->wrench.passes;
    }
    for (int i = 0; i < TICKS; i++) {
        turn(l, 0.01, 1e-3);
        turning += l->wrench.passes;
    }
    printf("%d ticks: %d passes while sliding, %d while turning\n", TICKS, sliding, turning);
    assert_int_equal(sliding, TICKS);
    assert_int_equal(turning, TICKS);
    lockstep_free(l);
}

/* After ten turns forward and ten back, the whole shaft has slid in both directions. Torque and lag of the tip are then at their limits for turning
   backward, although the base is at its initial angle. If the base is then turned forward a little, the shaft sticks. */
static void ten_turns_leave_what_friction_holds(void **unused) {
    (void)unused;
    simulation_config c = scene_with(DRY, 0.0);
    lockstep *l = engaged(&c);
    double f = DRY * l->parts.needle.radius, depth = l->state.tip.place.depth;
    turn(l, 20.0 * M_PI, 8.0);
    assert_true(fabs(l->state.base_turn - 20.0 * M_PI) < 1e-9);
    assert_true(fabs(-l->wrench.torque.z / (f * depth) - 1.0) < 0.01);
    turn(l, -20.0 * M_PI, 8.0);
    assert_true(fabs(l->state.base_turn) < 1e-9);
    assert_true(fabs(l->wrench.torque.z / (f * depth) - 1.0) < 0.01);
    double lag = f * (0.5 * depth * depth + depth * (l->parts.needle.given.length - depth)) / l->parts.needle.torsion;
    assert_true(fabs(l->state.tip_lead / lag - 1.0) < 0.01);
    /* nothing changes while the needle is held still */
    double before = l->wrench.torque.z;
    for (int i = 0; i < 100; i++) lockstep_tick(l, l->base, 1e-3);
    assert_true(fabs(l->wrench.torque.z - before) < 1e-12);
    /* going from one torque limit to the other takes twice the angle by which shaft and tissue are twisted at a limit, and no less */
    turn(l, 0.5 * lag, 0.1);
    assert_true(l->wrench.torque.z < before && l->wrench.torque.z > -0.9 * before);
    lockstep_free(l);
}

/* If the tissue is softer than the shaft is in torsion, a stuck shaft behaves as a rod on an elastic foundation with k = 4 pi mu r^2 per unit length
   (Winkler), so M = sqrt(GJ k) tanh(sqrt(k / GJ) l) angle. */
static void stuck_shaft_is_a_rod_in_a_foundation(void **unused) {
    (void)unused;
    simulation_config c = scene_with(1e4, 0.0);
    for (int i = 0; i < c.region_count; i++) c.regions[i].material.youngs_modulus = 30e3;
    c.insertion.contact_spacing = 1e-3;
    lockstep *l = engaged(&c);
    const needle_model *needle = &l->parts.needle;
    double mu = 30e3 / 2.9, k = 4.0 * M_PI * mu * needle->radius * needle->radius, depth = l->state.tip.place.depth, angle = 0.01;
    double rod = sqrt(needle->torsion * k) * tanh(sqrt(k / needle->torsion) * depth), before = (needle->given.length - depth) / needle->torsion;
    double expected = angle / (1.0 / rod + before);
    turn(l, angle, 0.05);
    printf("stuck: %.6g, expected %.6g\n", -l->wrench.torque.z, expected);
    assert_true(fabs(-l->wrench.torque.z / expected - 1.0) < 0.01);
    lockstep_free(l);
}

/* The bevel cuts in the direction given by the roll of the tip, not by that of the base. */
static void bevel_follows_the_tip(void **unused) {
    (void)unused;
    simulation_config c = scene_with(3e3, 0.0);
    c.needle.bevel_slope = 0.1;
    c.needle.outer_diameter = 0.5e-3; /* so thin and flexible that the shaft takes up most of the rotation outside the tissue */
    c.needle.inner_diameter = 0.0;
    c.needle.youngs_modulus = 20e9;
    lockstep *l = engaged(&c);
    turn(l, 0.5 * M_PI, 0.2);
    double roll = 0.5 * M_PI + l->state.tip_lead;
    assert_true(roll > 0.0 && roll < 1.0);
    tick_input tick = {.model = &l->parts.insertion};
    vec3 cut = needle_direction(&tick, &l->state);
    assert_true(v3_norm(v3_sub(cut, v3(0.1 * sin(roll), -0.1 * cos(roll), 1.0))) < 1e-3);
    lockstep_free(l);
}

static void without_turning_there_is_no_torque(void **unused) {
    (void)unused;
    simulation_config c = scene_with(DRY, 100.0);
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.05), 0.5, 1e-3);
    lockstep_move(l, v3(0.002, 0, 0), 0.1, 1e-3);
    assert_true(l->state.tip_lead == 0.0 && l->state.base_turn == 0.0);
    for (int k = 0; contact_is_active(&l->state, k); k++) assert_true(l->state.contacts[l->state.refined.order[k]].shaft.roll.torque == 0.0);
    lockstep_free(l);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tip_lags_by_the_twist_of_friction),
        cmocka_unit_test(turning_eases_sliding),
        cmocka_unit_test(turning_eases_insertion),
        cmocka_unit_test(turning_takes_one_pass),
        cmocka_unit_test(ten_turns_leave_what_friction_holds),
        cmocka_unit_test(stuck_shaft_is_a_rod_in_a_foundation),
        cmocka_unit_test(bevel_follows_the_tip),
        cmocka_unit_test(without_turning_there_is_no_torque),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
