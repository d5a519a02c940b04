/* Tests the whole tick: its forces against the sum of friction and cutting, its independence from tick rate, number of passes and worker, and every way into
   and out of the tissue. */
#include "figure8.h"
#include "insertion/tip/prefetch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

/* Returns a scene without viscous terms and with equal static and kinetic friction, so that the exact force curve is known. */
static simulation_config dry_config(void) {
    simulation_config c = lockstep_config();
    for (int i = 0; i < c.region_count; i++) {
        region_material *m = &c.regions[i].material;
        m->cutting_viscosity = m->friction_viscous = 0.0;
        m->cutting_force = 0.4;
        m->friction_static = m->friction_kinetic = 8.0;
    }
    return c;
}

static void axial_force_is_cutting_plus_friction_times_depth(void **unused) {
    (void)unused;
    simulation_config c = dry_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    int checked = 0;
    for (int i = 0; i < 85; i++) {
        lockstep_move(l, v3(0, 0, 0.001), 0.05, 1e-3);
        if (l->state.tip.barrier.blocked_by != NOT_BLOCKED || l->state.tip.solved.friction != SLIP_FORWARD || l->wrench.events || l->wrench.depth < 2e-3) continue;
        bool all_slide = l->state.tip.shaft.friction == SLIP_FORWARD;
        for (int k = 0; k < contacts_active(&l->state); k++) all_slide = all_slide && l->state.contacts[k].shaft.friction == SLIP_FORWARD;
        if (!all_slide) continue;
        assert_true(fabs(l->wrench.force.z + 0.4 + 8.0 * l->wrench.depth) < 1e-3);
        checked++;
    }
    assert_true(checked > 30);
    lockstep_free(l);
}

/* Membranes are punctured at the forces given in the scene. The base feels these in addition to the shaft's friction. */
static void membranes_puncture_at_their_forces(void **unused) {
    (void)unused;
    simulation_config c = dry_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    double before = 0.0;
    int found = 0;
    for (int i = 0; i < 8000; i++) {
        lockstep_move(l, v3(0, 0, 1e-5), 1e-3, 1e-3);
        if (l->wrench.events & EVENT_PUNCTURED) {
            double expected = c.membranes[l->wrench.membrane].puncture_force + 8.0 * l->wrench.depth;
            assert_int_equal(l->wrench.membrane, found++);
            assert_true(fabs(-before / expected - 1.0) < 0.02);
        }
        before = l->wrench.force.z;
    }
    assert_int_equal(found, 2);
    lockstep_free(l);
}

static void push_through_skin(lockstep *l) {
    for (int i = 0; i < 4000 && !(l->wrench.events & EVENT_PUNCTURED); i++) lockstep_move(l, v3(0, 0, 2e-5), 1e-3, 1e-3);
    assert_true(l->wrench.events & EVENT_PUNCTURED);
}

/* The base stops at puncture. Without friction on the shaft, the force must not increase afterwards, however deep the dent was. */
static void force_drops_after_the_skin(void **unused) {
    (void)unused;
    simulation_config c = dry_config();
    for (int i = 0; i < c.region_count; i++) {
        c.regions[i].material.friction_static = c.regions[i].material.friction_kinetic = 0.0;
        c.regions[i].material.cutting_viscosity = 1.0;
    }
    for (int k = 0; k < 3; k++) {
        c.membranes[0].puncture_force = 0.6 + 0.3 * k;
        lockstep *l = lockstep_create(&c, lockstep_start());
        push_through_skin(l);
        double before = -l->wrench.force.z, last = before, rise = 0.0;
        for (int i = 0; i < 200; i++, last = -l->wrench.force.z) {
            lockstep_tick(l, l->base, 1e-3);
            rise = fmax(rise, -l->wrench.force.z - last);
        }
        print_message("skin of %.1f N: largest rise per tick %.2g N, from %.3f to %.3f N\n", c.membranes[0].puncture_force, rise, before, last);
        assert_true(rise < 1e-5);
        assert_true(fabs(last - 0.4) < 0.02); /* the cutting force */
        lockstep_free(l);
    }
}

/* Without viscosity, the tip moves as fast as the tissue springs back, which is slower than a shear wave however long the tick is. */
static void tissue_springs_back_slower_than_waves(void **unused) {
    (void)unused;
    simulation_config c = dry_config();
    c.membranes[0].puncture_force = 1.2;
    const double density = 1000.0, wave = sqrt(c.regions[1].material.youngs_modulus / (2.0 * (1.0 + c.regions[1].material.poisson_ratio)) / density);
    for (double dt = 1e-3; dt > 0.2e-3; dt /= 2) {
        lockstep *l = lockstep_create(&c, lockstep_start());
        push_through_skin(l);
        double fastest = 0.0;
        for (int i = 0; i < 20e-3 / dt; i++) {
            double depth = l->state.tip.place.depth;
            lockstep_tick(l, l->base, dt);
            fastest = fmax(fastest, (l->state.tip.place.depth - depth) / dt);
        }
        print_message("ticks of %g ms: the tip leaps at %.2f m/s, shear waves at %.2f m/s\n", 1e3 * dt, fastest, wave);
        assert_true(fastest > 0.3 * wave && fastest < wave);
        lockstep_free(l);
    }
}

/* A tip pressed on the skin at an angle sticks inside the friction cone and slides outside it. */
static void tip_friction_on_the_skin_is_about_its_normal(void **unused) {
    (void)unused;
    simulation_config c = dry_config();
    c.membranes[0].puncture_force = 50.0;
    const double degrees[] = {10, 45, 70, 85, 89};
    for (int k = 0; k < 5; k++) {
        double tilt = degrees[k] * M_PI / 180.0;
        vec3 axis = v3(sin(tilt), 0, cos(tilt)), entry = v3(-0.01, 0.003, 0);
        lockstep *l = lockstep_create(&c, (pose){v3_axpy(-0.2001, axis, entry), q_exp(v3(0, tilt, 0))});
        lockstep_move(l, v3_scale(0.01, axis), 0.5, 1e-3);
        for (int i = 0; i < 20; i++) lockstep_tick(l, l->base, 1e-3);
        vec3 force = l->state.tip.solved.force;
        double tangential = hypot(force.x, force.y), slid = v3_norm(v3_sub(l->state.tip.place.nominal, entry));
        print_message("%g degrees: %.4f N into the skin, %.4f N along it; slid by %.2f mm\n", degrees[k], force.z, tangential, 1e3 * slid);
        assert_int_equal(l->state.tip.place.phase, TIP_INSIDE);
        assert_true(force.z > 0.0);
        assert_true(tangential < 0.5 * force.z + 1e-4);
        assert_true(degrees[k] < 20 ? slid < 1e-6 : slid > 1e-3);
        lockstep_free(l);
    }
}

/* Prints the force and torque of a run and compares them with those of another run. */
static void assert_alike(const char *what, double value, const figure8_record *a, const figure8_record *b, double shift, double limit) {
    double force = figure8_difference(a, b, 0, 3, shift), torque = figure8_difference(a, b, 3, 6, shift);
    print_message("%g %s: force differs by %.5f, torque by %.5f of the peak\n", value, what, force, torque);
    assert_int_equal(a->punctures, b->punctures);
    assert_true(force < limit && torque < limit);
}

static void forces_do_not_depend_on_the_rate(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    figure8_record *reference = figure8_run(&c, 4000, 1);
    assert_int_equal(reference->punctures, 2);
    for (double rate = 250; rate < 4000; rate *= 2) {
        figure8_record *r = figure8_run(&c, rate, 1);
        assert_alike("Hz", rate, r, reference, FIGURE8_SLOWEST_PERIOD, 0.01);
        free(r);
    }
    free(reference);
}

static void forces_do_not_depend_on_the_passes(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    figure8_record *standard = figure8_run(&c, 1000, 1);
    c.insertion.max_passes = 12;
    c.insertion.tolerance = 1e-12;
    figure8_record *converged = figure8_run(&c, 1000, 1);
    assert_alike("passes at most, as by default", 4, standard, converged, 0.0, 0.01);
    for (int passes = 1; passes <= 4; passes *= 2) {
        c.insertion.max_passes = passes;
        figure8_record *r = figure8_run(&c, 1000, 1);
        assert_alike("passes", passes, r, converged, 0.0, 0.01);
        free(r);
    }
    free(standard);
    free(converged);
}

static void force_is_continuous_away_from_punctures(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    figure8_record *r = figure8_run(&c, 1000, 1);
    print_message("largest jump of a tick: %.2f of max(7 %%, 0.05 N)\n", r->worst_jump);
    assert_true(r->worst_jump <= 1.0);
    assert_false(r->events & (EVENT_UNSTABLE | EVENT_FULL | EVENT_LATE));
    free(r);
}

static void both_remeshing_methods_give_the_same_forces(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    figure8_record *nested = figure8_run(&c, 500, 1);
    figure8_record *woodbury = figure8_run_by(REMESH_WOODBURY, &c, 500, 1);
    assert_alike("woodbury", 1, woodbury, nested, 0.0, 1e-6);
    free(nested);
    free(woodbury);
}

/* If the worker answers only every 20th tick, contacts are added later, but the forces stay close, and no tick waits. */
static void late_worker_has_little_effect(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    figure8_record *prompt = figure8_run(&c, 1000, 1), *late = figure8_run(&c, 1000, 20);
    assert_false(late->events & EVENT_UNSTABLE);
    assert_alike("ticks of delay at most", 20, late, prompt, 20e-3, 0.07);
    free(prompt);
    free(late);
}

static void below_the_friction_limit_motion_is_reversible(void **unused) {
    (void)unused;
    simulation_config c = dry_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.07), 1.0, 1e-3);
    lockstep_move(l, v3(0, 0, -0.0001), 0.1, 1e-3); /* unloads the needle without making any contact slide */
    tick_output before = l->wrench;
    for (int i = 0; i < 5; i++) {
        lockstep_move(l, v3(2e-5, 4e-5, -2e-5), 0.05, 1e-3);
        lockstep_move(l, v3(-2e-5, -4e-5, 2e-5), 0.05, 1e-3);
    }
    assert_true(v3_norm(v3_sub(l->wrench.force, before.force)) < 1e-6);
    assert_true(v3_norm(v3_sub(l->wrench.torque, before.torque)) < 1e-7);
    lockstep_free(l);
}

/* In tissue that closes behind the needle, a withdrawn needle leaves no track, so every insertion is like the first. */
static void reinsertion_repeats_the_first_insertion(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    c.insertion.track_reach = 0.0;
    lockstep *l = lockstep_create(&c, lockstep_start());
    double first[80] = {0};
    for (int round = 0; round < 4; round++) {
        for (int i = 0; i < 80; i++) {
            lockstep_move(l, v3(0, 0, 0.001), 0.02, 1e-3);
            if (round == 0) first[i] = l->wrench.force.z;
            assert_true(fabs(l->wrench.force.z - first[i]) < 1e-3 * 2.0);
        }
        lockstep_move(l, v3(0, 0, -0.080), 1.0, 1e-3);
        assert_int_equal(l->state.tip.place.phase, TIP_FREE);
        assert_int_equal(l->state.refined.count, 0);
        assert_true(v3_norm(l->wrench.force) == 0.0 && v3_norm(l->wrench.torque) == 0.0);
        lockstep_move(l, v3(0.01, 0.004, 0), 0.2, 1e-3); /* cuts a track nearby in the meantime */
        lockstep_move(l, v3(0, 0, 0.070), 1.0, 1e-3);
        lockstep_move(l, v3(0, 0, -0.070), 1.0, 1e-3);
        lockstep_move(l, v3(-0.01, -0.004, 0), 0.2, 1e-3);
    }
    lockstep_free(l);
}

/* The needle passes through a slab, exits on the far side, is drawn back, and exits again. */
static void needle_leaves_on_the_far_side_and_comes_back(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    pose start = {v3(-0.06, 0.0, 0.03), q_exp(v3(0, M_PI / 2, 0))}; /* points along +x, through the side faces of the 100 mm wide body */
    start.position.x = -0.255;
    lockstep *l = lockstep_create(&c, start);
    unsigned seen = 0;
    for (int round = 0; round < 2; round++) {
        for (int i = 0; i < 150; i++) {
            lockstep_move(l, v3(0.001, 0, 0), 0.02, 1e-3);
            seen |= l->wrench.events;
        }
        assert_int_equal(l->state.tip.place.phase, TIP_BEYOND);
        assert_true(fabs(l->wrench.depth - 0.1) < 2e-3);
        double pushing = l->wrench.force.x;
        assert_true(pushing < -0.5);
        lockstep_move(l, v3(-0.149, 0, 0), 2.0, 1e-3);
        assert_true(l->state.tip.place.phase == TIP_FREE || l->wrench.depth < 2e-3);
        lockstep_move(l, v3(-0.001, 0, 0), 0.1, 1e-3);
        assert_int_equal(l->state.tip.place.phase, TIP_FREE);
        assert_true(v3_norm(l->wrench.force) == 0.0);
    }
    lockstep_free(l);
}

/* Aims the needle exactly at nodes and along edges and faces of the mesh. */
static void degenerate_paths_are_handled(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    const mesh *m = &l->parts.mesh;
    int aimed = 0;
    for (int i = 0; i < m->node_count && aimed < 24; i++) {
        vec3 x = m->nodes[i];
        if (x.z > 0.0 || fabs(x.x) > 0.04 || fabs(x.y) > 0.03) continue; /* at each node of the skin, first goes in straight, then toward inner nodes */
        aimed++;
        int inner = (i * 37 + 11) % m->node_count;
        vec3 way = v3_sub(m->nodes[inner], x);
        if (way.z < 0.02) way = v3(0, 0, 0.05);
        vec3 axis = v3_unit(way), z = v3(0, 0, 1), turn = v3_cross(z, axis);
        double s = v3_norm(turn);
        pose start = {v3_axpy(-0.203, axis, x), s > 1e-12 ? q_exp(v3_scale(asin(fmin(s, 1.0)) / s, turn)) : (quat){1, 0, 0, 0}};
        insertion_reset(&l->parts.insertion, start, &l->state);
        l->base = start;
        for (int k = 0; k < 120; k++) {
            lockstep_move(l, v3_scale(k < 60 ? 1e-3 : -1e-3, axis), 0.02, 1e-3);
            assert_false(l->wrench.events & EVENT_UNSTABLE);
            assert_true(v3_norm(l->wrench.force) < 8.0);
        }
        lockstep_move(l, v3_scale(-5e-3, axis), 0.1, 1e-3);
        assert_int_equal(l->state.tip.place.phase, TIP_FREE);
    }
    assert_true(aimed > 20);
    lockstep_free(l);
}

static double uniform(unsigned *seed) { return (double)rand_r(seed) / RAND_MAX; }

/* However the hand moves, the forces stay finite and bounded, and withdrawing always restores the initial state. */
static void random_motions_are_handled(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    c.needle.bevel_slope = 0.03;
    lockstep *l = lockstep_create(&c, lockstep_start());
    unsigned seed = 7;
    for (int run = 0; run < 6; run++) {
        pose start = lockstep_start();
        start.position.x += 0.03 * (uniform(&seed) - 0.5);
        start.position.y += 0.03 * (uniform(&seed) - 0.5);
        insertion_reset(&l->parts.insertion, start, &l->state);
        l->base = start;
        for (int leg = 0; leg < 25; leg++) {
            vec3 way = v3(0.006 * (uniform(&seed) - 0.5), 0.006 * (uniform(&seed) - 0.5), 0.03 * (uniform(&seed) - 0.3));
            l->base.orientation = q_unit(q_multiply(q_exp(v3(0, 0, 0.3 * (uniform(&seed) - 0.5))), l->base.orientation));
            lockstep_move(l, way, 0.05 + 0.3 * uniform(&seed), 1e-3);
            assert_true(isfinite(v3_norm(l->wrench.force)) && v3_norm(l->wrench.force) < 30.0);
            assert_false(l->wrench.events & EVENT_UNSTABLE);
        }
        lockstep_move(l, v3(0, 0, -0.206 - l->base.position.z), 1.0, 1e-3);
        assert_int_equal(l->state.tip.place.phase, TIP_FREE);
    }
    lockstep_free(l);
}

/* A needle pushed against an impenetrable membrane until it buckles reports this and can be withdrawn as usual. */
static void buckled_needle_recovers(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    c.membranes[1].puncture_force = INFINITY;
    lockstep *l = lockstep_create(&c, lockstep_start());
    for (int i = 0; i < 170; i++) {
        lockstep_move(l, v3(0, 0, 0.001), 0.02, 1e-3);
        assert_true(isfinite(v3_norm(l->wrench.force)));
        int tet = l->state.tip.place.tet, region = tet >= 0 ? l->parts.mesh.region[tet] : -1;
        assert_int_not_equal(region, mesh_find_group(&l->parts.mesh, "prostate", 3)); /* never gets through the capsule */
    }
    for (int i = 0; i < 180; i++) {
        lockstep_move(l, v3(0, 0, -0.001), 0.02, 1e-3);
        assert_true(v3_norm(l->wrench.force) < 20.0);
    }
    assert_int_equal(l->state.tip.place.phase, TIP_FREE);
    assert_true(v3_norm(l->wrench.force) == 0.0);
    lockstep_move(l, v3(0.005, 0, 0), 0.1, 1e-3); /* away from the needle's old track */
    lockstep_move(l, v3(0, 0, 0.03), 0.5, 1e-3);
    assert_true(l->wrench.force.z < -0.3);
    lockstep_free(l);
}

/* The needle is pressed on the skin, dragged over it, lifted and tilted. However it left the skin, the next insertion must produce a force. */
static void every_insertion_gives_force(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    unsigned seed = 3;
    for (int run = 0; run < 40; run++) {
        double tilt = 0.35 * (run % 4) / 3.0, heading = 2 * M_PI * uniform(&seed);
        pose start = {v3(0, 0, 0), q_exp(v3(tilt * cos(heading), tilt * sin(heading), 0))};
        vec3 axis = q_rotate(start.orientation, v3(0, 0, 1));
        start.position = v3_axpy(-0.203, axis, v3(0.01 * uniform(&seed), 0.01 * uniform(&seed), 0));
        insertion_reset(&l->parts.insertion, start, &l->state);
        l->base = start;
        lockstep_move(l, v3_scale(0.004 + 0.006 * uniform(&seed), axis), 0.2, 1e-3);
        lockstep_move(l, v3(0.01 * (uniform(&seed) - 0.5), 0.01 * (uniform(&seed) - 0.5), 0), 0.2, 1e-3);
        for (int k = 0; k < 200 && l->state.tip.place.phase != TIP_FREE; k++) lockstep_move(l, v3_scale(-1e-4, axis), 2e-3, 1e-3);
        lockstep_move(l, v3_scale(0.03, axis), 0.5, 1e-3);
        assert_int_equal(l->state.tip.place.phase, TIP_INSIDE);
        assert_true(v3_norm(l->wrench.force) > 0.3);
    }
    lockstep_free(l);
}

/* After a long stall comes a single tick with bounded work, not a burst of ticks. */
static void long_tick_needs_few_steps(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    insertion_settings *settings = &l->parts.insertion.settings;
    lockstep_move(l, v3(0, 0, 0.03), 0.5, 1e-3);
    for (settings->most_steps = 4; settings->most_steps >= 1; settings->most_steps -= 3) {
        pose later = l->base;
        later.position.z += 0.002;
        lockstep_tick(l, later, 5.0);
        assert_in_range(l->wrench.passes, settings->most_steps, settings->most_steps * settings->max_passes);
        assert_true(isfinite(v3_norm(l->wrench.force)));
    }
    lockstep_free(l);
}

/* If the server is restarted with the needle in the tissue, the needle counts as inserted and carries no force. It can be withdrawn as usual, even where
   nodes next to the track had been shifted away from faces. */
static void needle_found_in_the_tissue_is_engaged_without_force(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    pose inside = lockstep_start();
    inside.position.z += 0.061;
    lockstep *l = lockstep_create(&c, inside);
    assert_int_equal(l->state.tip.place.phase, TIP_INSIDE);
    assert_true(fabs(l->state.tip.place.depth - 0.060) < 1e-9);
    for (int i = 0; i < 5; i++) lockstep_tick(l, inside, 1e-3);
    assert_true(l->wrench.contacts > 8);
    assert_true(v3_norm(l->wrench.force) < 1e-4);
    lockstep_move(l, v3(0, 0, -0.070), 1.0, 1e-3);
    assert_int_equal(l->state.tip.place.phase, TIP_FREE);
    lockstep_free(l);
}

/* The state and the snapshot are plain data, so a run that continues from a restored copy gives bit-identical results. */
static void restored_state_continues_bit_identically(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.055), 0.8, 1e-3);
    insertion_state saved = l->state;
    pose base = l->base;
    compliance_snapshot *known = malloc(sizeof *known);
    memcpy(known, l->snapshot, sizeof *known);
    lockstep_move(l, v3(0.001, 0.002, 0.01), 0.2, 1e-3);
    tick_output once = l->wrench;
    l->state = saved;
    l->base = base;
    memcpy(l->snapshot, known, sizeof *known);
    lockstep_move(l, v3(0.001, 0.002, 0.01), 0.2, 1e-3);
    assert_memory_equal(&once.force, &l->wrench.force, sizeof once.force);
    assert_memory_equal(&once.torque, &l->wrench.torque, sizeof once.torque);
    free(known);
    lockstep_free(l);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(axial_force_is_cutting_plus_friction_times_depth),
        cmocka_unit_test(membranes_puncture_at_their_forces),
        cmocka_unit_test(force_drops_after_the_skin),
        cmocka_unit_test(tissue_springs_back_slower_than_waves),
        cmocka_unit_test(tip_friction_on_the_skin_is_about_its_normal),
        cmocka_unit_test(forces_do_not_depend_on_the_rate),
        cmocka_unit_test(forces_do_not_depend_on_the_passes),
        cmocka_unit_test(force_is_continuous_away_from_punctures),
        cmocka_unit_test(both_remeshing_methods_give_the_same_forces),
        cmocka_unit_test(late_worker_has_little_effect),
        cmocka_unit_test(below_the_friction_limit_motion_is_reversible),
        cmocka_unit_test(reinsertion_repeats_the_first_insertion),
        cmocka_unit_test(needle_leaves_on_the_far_side_and_comes_back),
        cmocka_unit_test(degenerate_paths_are_handled),
        cmocka_unit_test(random_motions_are_handled),
        cmocka_unit_test(buckled_needle_recovers),
        cmocka_unit_test(every_insertion_gives_force),
        cmocka_unit_test(long_tick_needs_few_steps),
        cmocka_unit_test(needle_found_in_the_tissue_is_engaged_without_force),
        cmocka_unit_test(restored_state_continues_bit_identically),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
