/* Tests the tip's path through the mesh: first touch, obstacles, contact nodes placed along the track, and withdrawal. */
#include "lockstep.h"
#include "insertion/tip/tip.h"
#include "insertion/track/obstacle.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static lockstep *touching(void) {
    simulation_config c = lockstep_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    tick_output wrench = {.membrane = -1};
    const tick_input tick = {.model = &l->parts.insertion};
    assert_true(tip_touch(&tick, &l->state, &wrench, v3(0.005, 0.003, -0.001), v3(0.005, 0.003, 0.001)));
    assert_int_equal(wrench.events, EVENT_TOUCHED);
    return l;
}

static tick_output go(lockstep *l, double slip) {
    tick_output wrench = {.membrane = -1};
    l->state.tip.solved.slip = slip;
    const tick_input tick = {.model = &l->parts.insertion};
    tip_move(&tick, &l->state, &l->run.workspace->creep, &wrench, tip_cut_direction(&tick, &l->state, v3(0, 0, 0)));
    return wrench;
}

static tick_output break_through(lockstep *l) {
    tick_output wrench = {.membrane = -1};
    l->state.tip.solved.slip = 1e-6;
    tip_puncture(&(tick_input){.model = &l->parts.insertion}, &l->state, NULL, &wrench);
    return wrench;
}

static bool in_its_element(const lockstep *l) {
    double w[4];
    mesh_barycentric(&l->parts.mesh, l->state.tip.place.tet, l->state.tip.place.nominal, w);
    return w[0] > -1e-6 && w[1] > -1e-6 && w[2] > -1e-6 && w[3] > -1e-6;
}

static void skin_stops_it_until_punctured(void **unused) {
    (void)unused;
    lockstep *l = touching();
    assert_true(fabs(l->state.tip.place.nominal.z) < 1e-12);
    assert_true(tip_resistance(&l->parts.insertion, &l->state.tip) == l->parts.config.membranes[0].puncture_force);
    go(l, 0.01);
    assert_true(l->state.tip.place.depth == 0.0);
    assert_int_equal(break_through(l).membrane, 0);
    assert_true(tip_resistance(&l->parts.insertion, &l->state.tip) == l->parts.config.regions[1].material.cutting_force);
    go(l, 0.01);
    assert_true(fabs(l->state.tip.place.depth - 0.01) < 1e-6 && fabs(l->state.tip.place.nominal.z - 0.01) < 1e-6);
    lockstep_free(l);
}

/* The capsule is an ellipsoid around (0, 0, 55) mm with semi-axes of 24, 17 and 20 mm, approximated by flat facets. */
static void capsule_stops_the_tip_at_its_surface(void **unused) {
    (void)unused;
    lockstep *l = touching();
    break_through(l);
    go(l, 0.06);
    double expected = 0.055 - 0.020 * sqrt(1.0 - pow(5.0 / 24.0, 2) - pow(3.0 / 17.0, 2));
    assert_int_equal(l->state.tip.barrier.blocked_by, 1);
    assert_true(fabs(l->state.tip.place.nominal.z - expected) < 2.5e-3);
    int outside = l->state.tip.place.tet;
    break_through(l);
    assert_int_not_equal(l->parts.mesh.region[l->state.tip.place.tet], l->parts.mesh.region[outside]);
    lockstep_free(l);
}

/* Pushes the tip through the capsule, with `layers` layers already recorded in the track. */
static tick_output into_the_gland_after(lockstep *l, int layers) {
    break_through(l);
    go(l, 0.06);
    for (int i = 0; i < layers; i++) l->state.strata[i] = (stratum){.depth = 0.0, .region = l->parts.mesh.region[l->state.tip.place.tet]};
    l->state.stratum_count = layers;
    return break_through(l);
}

static void full_membrane_list_is_reported(void **unused) {
    (void)unused;
    lockstep *l = touching();
    assert_false(into_the_gland_after(l, MAX_STRATA - 1).events & EVENT_FULL);
    assert_int_equal(l->state.stratum_count, MAX_STRATA);
    lockstep_free(l);
    l = touching();
    assert_true(into_the_gland_after(l, MAX_STRATA).events & EVENT_FULL);
    assert_int_equal(l->state.stratum_count, MAX_STRATA);
    lockstep_free(l);
}

static void tip_never_enters_bone(void **unused) {
    (void)unused;
    lockstep *l = touching();
    int gland = mesh_find_group(&l->parts.mesh, "prostate", 3);
    l->parts.materials[gland].cutting_force = INFINITY;
    break_through(l);
    go(l, 0.06);
    assert_int_equal(l->state.tip.barrier.blocked_by, BLOCKED_BY_BONE);
    assert_true(isinf(tip_resistance(&l->parts.insertion, &l->state.tip)));
    assert_int_not_equal(l->parts.mesh.region[l->state.tip.place.tet], gland);
    lockstep_free(l);
}

/* Contact nodes lie on the track in order, at least the minimum spacing apart. Withdrawal removes them and ends outside the tissue. */
static void insertion_and_retraction(void **unused) {
    (void)unused;
    lockstep *l = touching();
    break_through(l);
    double spacing = l->parts.insertion.settings.contact_spacing;
    for (int i = 0; i < 300; i++) {
        if (go(l, 1e-4), l->state.tip.barrier.blocked_by != NOT_BLOCKED) break_through(l);
        assert_true(in_its_element(l));
    }
    int left = contacts_passed(&l->state);
    assert_true(left >= 5);
    for (int i = 0; i < left; i++) {
        double z = l->state.refined.nodes[i].position.z;
        assert_true(fabs(z - l->state.contacts[i].depth) < 0.03 * 0.02 && z < l->state.tip.place.nominal.z + 1e-9);
        if (i > 0) assert_true(l->state.contacts[i].depth - l->state.contacts[i - 1].depth > spacing - 1e-12);
    }
    unsigned seen = 0;
    for (int i = 0; i < 400 && l->state.tip.place.phase == TIP_INSIDE; i++) {
        seen |= go(l, -1e-4).events;
        if (l->state.tip.place.phase == TIP_INSIDE) assert_true(in_its_element(l));
    }
    assert_int_equal(l->state.tip.place.phase, TIP_FREE);
    assert_int_equal(l->state.refined.count, 0);
    assert_true(seen & EVENT_REMOVED && seen & EVENT_WITHDRAWN);
    lockstep_free(l);
}

static void bevel_deflects_the_cut_away_from_its_face(void **unused) {
    (void)unused;
    lockstep *l = touching();
    l->parts.needle.given.bevel_slope = 0.1;
    break_through(l);
    go(l, 0.01);
    assert_true(fabs((l->state.tip.place.nominal.y - 0.003) / l->state.tip.place.nominal.z + 0.1) < 1e-6);
    lockstep_free(l);
}

/* Presses a needle against hard tissue `before` (m) in front of the capsule, and then removes the tissue's resistance. The tissue springs back over the tip,
   which reaches the capsule at about 0.5 m/s while the hand advances at 20 mm/s. */
static lockstep *released_before_the_capsule(double before, double puncture_force) {
    simulation_config config = lockstep_config();
    config.membranes[1].puncture_force = puncture_force;
    lockstep *l = lockstep_create(&config, lockstep_start());
    const needle_tip *tip = &l->state.tip;
    double chord = INFINITY;
    int steps = 0;
    for (bool ahead = false; !ahead || chord > before; steps++) {
        assert_true(steps < 10000); /* 10000 steps are 200 mm, and the capsule is closer than that */
        lockstep_move(l, v3(0, 0, 2e-5), 1e-3, 1e-3);
        int face = tip->place.phase == TIP_INSIDE ? mesh_exit(&l->parts.mesh, tip->place.tet, tip->place.nominal, tip->place.direction, &chord) : -1;
        ahead = face >= 0 && l->parts.mesh.face_groups[tip->place.tet][face] >> l->parts.membranes[1].group & 1;
    }
    region_material *around = &l->parts.materials[l->parts.mesh.region[tip->place.tet]];
    double cutting = around->cutting_force;
    around->cutting_force = 1.0;
    lockstep_move(l, v3(0, 0, 0.004), 0.2, 1e-3);
    around->cutting_force = cutting;
    return l;
}

/* The tip stops at the capsule within the step in which it gets there. Tissue that has sprung back is pushed forward again by no more than the hand moves. */
static void a_tip_that_springs_forward_stops_at_a_membrane(void **unused) {
    (void)unused;
    double jumps = 0.0;
    for (int i = 0; i < 12; i++) {
        lockstep *l = released_before_the_capsule(2e-4 + 1e-4 * i, 5.0);
        double dent = l->state.tip.dent.size, rise = 0.0;
        for (int k = 0; k < 20; k++) {
            lockstep_move(l, v3(0, 0, 2e-5), 1e-3, 1e-3);
            rise = fmax(rise, l->state.tip.dent.size - dent);
            dent = l->state.tip.dent.size;
        }
        assert_int_equal(l->state.tip.barrier.blocked_by, 1);
        jumps = fmax(jumps, rise);
        lockstep_free(l);
    }
    print_message("the dent grows by %.1f um in a tick at most\n", 1e6 * jumps);
    assert_true(jumps < 2.5e-5);
}

/* A membrane whose resistance is below the cutting force does not stop the tip. */
static void a_weak_membrane_is_pierced_in_passing(void **unused) {
    (void)unused;
    for (int i = 0; i < 6; i++) {
        lockstep *l = released_before_the_capsule(2e-4 + 2e-4 * i, 0.3);
        unsigned seen = 0;
        double dent = l->state.tip.dent.size;
        for (int k = 0; k < 20; k++) {
            vec3 last = l->wrench.force;
            lockstep_move(l, v3(0, 0, 2e-5), 1e-3, 1e-3);
            if (l->wrench.events & EVENT_PUNCTURED) {
                assert_int_equal(l->wrench.membrane, 1);
                assert_int_equal(l->state.tip.barrier.blocked_by, NOT_BLOCKED);
                assert_true(v3_norm(v3_sub(l->wrench.force, last)) < 0.05);
            }
            assert_true(l->state.tip.dent.size < dent + 1e-7);
            seen |= l->wrench.events;
            dent = l->state.tip.dent.size;
        }
        assert_true(seen & EVENT_PUNCTURED);
        lockstep_free(l);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(skin_stops_it_until_punctured), cmocka_unit_test(capsule_stops_the_tip_at_its_surface),
        cmocka_unit_test(full_membrane_list_is_reported),
        cmocka_unit_test(tip_never_enters_bone),         cmocka_unit_test(insertion_and_retraction),
        cmocka_unit_test(bevel_deflects_the_cut_away_from_its_face),
        cmocka_unit_test(a_tip_that_springs_forward_stops_at_a_membrane),
        cmocka_unit_test(a_weak_membrane_is_pierced_in_passing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
