/* Tests that the default scene's pubic arch stops the tip, is felt by the hand, fixes the tissue if the scene says so, and can be avoided by steering a
   bevelled needle around it. */
#include "lockstep.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include "check.h"

static const double WAY = 0.066;         /* m, travel of the base, more than the arch's depth of about 25 mm */

static const vec3 BEHIND = {0.014, 0.014, 0};   /* a point that a straight path along z can only reach through the arch */

static simulation_config arch_scene(bool held) {
    simulation_config c = lockstep_scene(MESHES "/prostate.yaml");
    assert_string_equal(c.fixed[c.fixed_count - 1], "bone");
    if (!held) c.fixed_count--;
    return c;
}

static pose start_at(const simulation_config *c, vec3 line, double roll) {
    return (pose){v3(line.x, line.y, -1e-3 - c->needle.length), q_exp(v3(0, 0, roll))};
}

typedef struct {
    double depth, force;     /* depth: at the end, m; force: largest axial force, N */
    double at_rest;          /* N, axial force after the hand has held still for 0.3 s */
    double beyond;           /* m, how far along z the tip gets past the point where the bone stops it, at most */
    bool stopped;
    unsigned events;
} outcome;

static vec3 needle_end(const lockstep *l) { return l->state.needle.joints[l->parts.needle.given.segments]; }

/* Returns the current position of the tissue's material point that the tip has reached. */
static vec3 stopped_at(const lockstep *l, const vec3 *displacement) {
    const needle_tip *tip = &l->state.tip;
    double weights[4];
    vec3 now = tip->place.nominal;
    mesh_barycentric(&l->parts.mesh, tip->place.tet, tip->place.nominal, weights);
    for (int c = 0; c < 4; c++) now = v3_axpy(weights[c], displacement[l->parts.mesh.tets[tip->place.tet][c]], now);
    return now;
}

static outcome push(const simulation_config *config, vec3 line, double speed) {
    lockstep *l = lockstep_create(config, start_at(config, line, 0.0));
    vec3 *nominal = calloc((size_t)l->parts.mesh.node_count, sizeof *nominal), added[MAX_CONTACTS + 1];
    outcome o = {0};
    int ticks = (int)(WAY / speed / 1e-3);
    for (int i = 1; i <= ticks + 300; i++) {
        pose base = start_at(config, line, 0.0);
        base.position.z += WAY * fmin(1.0, (double)i / ticks);
        lockstep_tick(l, base, 1e-3);
        o.events |= l->wrench.events;
        o.force = fmax(o.force, -l->wrench.force.z);
        o.stopped = l->state.tip.barrier.blocked_by >= 0 && isinf(config->membranes[l->state.tip.barrier.blocked_by].puncture_force);
        if (!o.stopped) continue;
        run_displacement(&l->run, &l->state, nominal, added);
        o.beyond = fmax(o.beyond, needle_end(l).z - stopped_at(l, nominal).z);
    }
    o.depth = l->wrench.depth;
    o.at_rest = -l->wrench.force.z;
    print_message("%g m/s: depth %.1f mm, force %.2f N, at rest %.2f N, beyond %.3f mm, %s, events %#x\n", speed, 1e3 * o.depth, o.force, o.at_rest, 1e3 * o.beyond,
                  o.stopped ? "stopped" : "not stopped", o.events);
    free(nominal);
    lockstep_free(l);
    return o;
}

/* The hand feels the bone up to the load at which the needle buckles, and the tip sinks into the bone's surface by at most 0.1 mm per newton. Euler's load
   is 20.2 EI / L^2 = 13.3 N for the free length of 177 mm, clamped at one end and hinged at the other. This holds whether the bone fixes the tissue or moves
   with it, and whether the needle gets there slowly or within one tick. */
static void arch_stops_the_tip_at_any_speed(void **unused) {
    (void)unused;
    const double speeds[] = {0.03, 0.2, 1.0};
    for (int held = 0; held < 2; held++) {
        simulation_config c = arch_scene(held);
        for (int i = 0; i < 3; i++) {
            outcome o = push(&c, BEHIND, speeds[i]);
            assert_true(o.stopped);
            assert_true(o.depth > 0.015 && o.depth < 0.025);
            assert_true(o.force > 10.0);
            assert_true(o.beyond < 1.0e-4 * o.force);
            assert_true(o.at_rest > 10.0 && o.at_rest < 15.0);
            if (!(held && speeds[i] == 1.0)) assert_true(o.force < 15.0);
            assert_false(o.events & (EVENT_EXITED | EVENT_WITHDRAWN));
        }
    }
}

/* Bone that fixes the tissue stops a needle moving at 1 m/s with no more force than a slow one. */
static void fixed_bone_bears_no_more_at_a_metre_a_second(void **unused) {
    (void)unused;
    simulation_config c = arch_scene(true);
    assert_true(push(&c, BEHIND, 1.0).force < 15.0);
}

static void tip_passes_beside_the_arch(void **unused) {
    (void)unused;
    simulation_config c = arch_scene(true);
    outcome o = push(&c, v3(0.005, 0.003, 0), 0.1);
    assert_false(o.stopped);
    assert_true(o.depth > 0.05 && o.force < 4.0);
}

/* The steered tip reaches a point that no straight path reaches. */
static void bevelled_needle_steers_around_the_arch(void **unused) {
    (void)unused;
    simulation_config c = arch_scene(true);
    c.needle.bevel_slope = 0.15;
    lockstep *l = lockstep_create(&c, start_at(&c, v3(0.014, -0.002, 0), M_PI));
    lockstep_move(l, v3(0, 0, 0.068), 1.4, 1e-3);
    vec3 there = l->state.tip.place.nominal;
    print_message("steered to %.1f %.1f %.1f mm, blocked by %d\n", 1e3 * there.x, 1e3 * there.y, 1e3 * there.z, l->state.tip.barrier.blocked_by);
    assert_true(there.z > 0.05 && l->state.tip.barrier.blocked_by == NOT_BLOCKED);
    lockstep_free(l);
    c.needle.bevel_slope = 0.0;
    assert_true(push(&c, there, 0.1).stopped);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(arch_stops_the_tip_at_any_speed),
        cmocka_unit_test(fixed_bone_bears_no_more_at_a_metre_a_second),
        cmocka_unit_test(tip_passes_beside_the_arch),
        cmocka_unit_test(bevelled_needle_steers_around_the_arch),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
