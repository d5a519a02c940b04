/* Tests that a buckling needle goes continuously from straight to bowed and back. Along the way, its force must be continuous, and no energy may be created. */
#include "lockstep.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

/* ---- an elastica --------------------------------------------------------------------------------------------------- */

/* Integrates the elastica from the clamped end by the midpoint rule (m, N, N m^2): the moment EI kappa satisfies EI kappa' = -push sin(theta) - across
   cos(theta). Sets the residuals at the hinged end, curvature and lateral position, and returns by how much the ends have approached each other. */
static double shoot(double bending, double length, double push, const double unknown[2], double left[2]) {
    int n = 4000;
    double theta = 0.0, kappa = unknown[0], ds = length / n, x = 0.0, y = 0.0;
    for (int i = 0; i < n; i++) {
        double tm = theta + 0.5 * ds * kappa, km = kappa - 0.5 * ds * (push * sin(theta) + unknown[1] * cos(theta)) / bending;
        x += ds * cos(tm), y += ds * sin(tm);
        kappa -= ds * (push * sin(tm) + unknown[1] * cos(tm)) / bending;
        theta += ds * km;
    }
    left[0] = kappa * length, left[1] = y / length;
    return length - x;
}

/* Returns the shortening (m) of a column under a push beyond Euler's load. The column is clamped at one end and hinged at the other, with the two ends in
   line. */
static double shortening(double bending, double length, double push) {
    double euler = 20.1907 * bending / (length * length), root = sqrt(push / euler - 1.0), scale[2] = {1.0 / length, euler};
    double u[2] = {15.0 * root / length, -1.4 * euler * root}, left[2], moved[2], short_by = 0.0;
    for (int pass = 0; pass < 60; pass++) {
        double j[2][2];
        short_by = shoot(bending, length, push, u, left);
        if (fabs(left[0]) + fabs(left[1]) < 1e-10) break;
        for (int k = 0; k < 2; k++) {
            double changed[2] = {u[0], u[1]}, h = 1e-6 * scale[k];
            changed[k] += h;
            shoot(bending, length, push, changed, moved);
            for (int i = 0; i < 2; i++) j[i][k] = (moved[i] - left[i]) / h;
        }
        double d = j[0][0] * j[1][1] - j[0][1] * j[1][0];
        u[0] -= (j[1][1] * left[0] - j[0][1] * left[1]) / d;
        u[1] -= (j[0][0] * left[1] - j[1][0] * left[0]) / d;
    }
    assert_true(fabs(left[0]) + fabs(left[1]) < 1e-8);
    return short_by;
}

static double bending_of(const simulation_config *c) {
    return c->needle.youngs_modulus * M_PI / 64.0 * (pow(c->needle.outer_diameter, 4) - pow(c->needle.inner_diameter, 4));
}

/* On skin as hard as bone, a needle pushed 30 mm beyond Euler's load carries the load of the elastica. */
static void a_bowed_column_is_the_elastica(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    for (int i = 0; i < c.region_count; i++) c.regions[i].material.youngs_modulus = 1e9;
    for (int i = 0; i < c.membrane_count; i++) c.membranes[i].puncture_force = INFINITY;
    double bending = bending_of(&c), length = c.needle.length, euler = 20.1907 * bending / (length * length), worst = 0.0;
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 1e-3), 0.05, 1e-3);
    for (int i = 1; i <= 30; i++) {
        lockstep_move(l, v3(0, 0, 1e-3), 0.05, 1e-3);
        double low = euler * (1.0 + 1e-5), high = 1.2 * euler;
        while (high - low > 1e-5 * euler) {
            double middle = 0.5 * (low + high);
            if (shortening(bending, length, middle) < 1e-3 * i) low = middle; else high = middle;
        }
        worst = fmax(worst, fabs(-l->wrench.force.z / low - 1.0));
        if (i % 10 == 0) print_message("%d mm: %.3f N, elastica %.3f N\n", i, -l->wrench.force.z, low);
        assert_false(l->wrench.events & EVENT_UNSTABLE);
    }
    assert_true(worst < 0.02);
    lockstep_free(l);
}

/* ---- there and back ------------------------------------------------------------------------------------------------ */

typedef struct {
    double most, at_end;     /* N */
    /* N/m, largest ratio of change in force to hand motion before buckling, i.e. the stiffness the hand works against */
    double stiffest;
    double jump;             /* largest change in force per tick after buckling, relative to the just noticeable change or that due to `stiffest` */
    double work, most_work;  /* J; work: done by the hand so far; most_work: its maximum along the path */
    int passes;              /* largest number of passes in a tick */
} path;

/* Moves the hand along the axis by `way` (m) and back until the needle touches nothing. Changes in force at puncture do not count as jumps. */
static path there_and_back(lockstep *l, double way, double speed) {
    const double noticed = 0.05, noticed_part = 0.07; /* just noticeable change, in N and as a fraction of the force */
    int ticks = (int)(way / (speed * 1e-3) + 0.5);
    path p = {0};
    vec3 last = l->wrench.force;
    for (int i = 1; i <= 2 * ticks; i++) {
        double step = i <= ticks ? speed * 1e-3 : -speed * 1e-3;
        lockstep_move(l, v3(0, 0, step), 1e-3, 1e-3);
        vec3 force = l->wrench.force;
        double change = v3_norm(v3_sub(force, last));
        bool bowed = needle_energy(&l->parts.needle, &l->state.needle) > 1e-6, punctured = l->wrench.events & EVENT_PUNCTURED;
        if (!bowed && i <= ticks) p.stiffest = fmax(p.stiffest, change / fabs(step));
        double allowed = fmax(fmax(noticed, noticed_part * v3_norm(last)), p.stiffest * fabs(step));
        if (bowed && !punctured) p.jump = fmax(p.jump, change / allowed);
        p.work -= step * 0.5 * (force.z + last.z);
        p.most_work = fmax(p.most_work, p.work);
        p.most = fmax(p.most, v3_norm(force));
        if (i == ticks) p.at_end = v3_norm(force);
        if (l->wrench.passes > p.passes) p.passes = l->wrench.passes;
        assert_false(l->wrench.events & EVENT_UNSTABLE);
        last = force;
    }
    print_message("%g mm/s: up to %.2f N, %.2f N at the end; largest change in a tick %.2f of what is allowed, work %.2f of %.1f mJ; up to %d passes\n", 1e3 * speed, p.most, p.at_end,
                  p.jump, 1e3 * p.work, 1e3 * p.most_work, p.passes);
    return p;
}

static void check_path(const lockstep *l, path p, double least) {
    assert_true(p.jump < 1.0);
    assert_true(p.work > -1e-3 * p.most_work);
    assert_true(p.at_end > least);
    assert_int_equal(l->state.tip.place.phase, TIP_FREE);
    assert_true(v3_norm(l->wrench.force) < 1e-9);
}

/* A needle in a template's hole with clearance pushes on skin that is never punctured. At any speed, it keeps carrying more than Euler's load for a needle
   hinged at the plate's front face, and returns along the same path. */
static void a_guided_needle_comes_back_as_it_went(void **unused) {
    (void)unused;
    const double speeds[] = {0.02, 0.1};
    for (int i = 0; i < 2; i++) {
        simulation_config c = lockstep_config();
        for (int k = 0; k < c.region_count; k++) c.regions[k].material.youngs_modulus = 2e6;
        for (int k = 0; k < c.membrane_count; k++) c.membranes[k].puncture_force = INFINITY;
        double thickness = 0.02, before_skin = 0.012, clearance = 0.115e-3;
        vec3 entry = {lockstep_start().position.x, lockstep_start().position.y, -before_skin - thickness};
        c.guide_count = 1;
        c.guides[0] = (guide_config){.origin = entry, .normal = {0, 0, 1}, .along = {1, 0, 0}, .rows_along = {0, 1, 0}, .columns = 1, .rows = 1, .spacing = 5e-3,
                                     .hole_diameter = c.needle.outer_diameter + 2.0 * clearance, .thickness = thickness, .stiffness = 50e3, .friction = 0.1};
        pose start = lockstep_start();
        start.position.z -= 0.04;
        lockstep *l = lockstep_create(&c, start);
        lockstep_move(l, v3(0, 0, 0.0405), 2.0, 1e-3);
        path p = there_and_back(l, 0.02, speeds[i]);
        double span = c.needle.length - before_skin - thickness;
        check_path(l, p, 20.1907 * bending_of(&c) / (span * span));
        lockstep_free(l);
    }
}

/* The needle buckles in tissue, 23 mm deep, against the pubic arch. */
static void a_needle_that_buckles_at_bone_comes_back(void **unused) {
    (void)unused;
    const double speeds[] = {0.03, 0.05};
    for (int held = 0; held < 2; held++)
        for (int i = 0; i < 2; i++) {
            simulation_config c = lockstep_scene(MESHES "/prostate.yaml");
            if (!held) c.fixed_count--;
            lockstep *l = lockstep_create(&c, (pose){v3(0.014, 0.014, -1e-3 - c.needle.length), {1, 0, 0, 0}});
            path p = there_and_back(l, 0.066, speeds[i]);
            check_path(l, p, 10.0);
            lockstep_free(l);
        }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_bowed_column_is_the_elastica),
        cmocka_unit_test(a_guided_needle_comes_back_as_it_went),
        cmocka_unit_test(a_needle_that_buckles_at_bone_comes_back),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
