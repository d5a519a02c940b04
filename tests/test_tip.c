/* The tip's way through the mesh: where it touches, what stops it, the nodes that it leaves, and the way back. */
#include "lockstep.h"
#include "insertion/tip.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static const vec3 NO_GRADIENT = {0, 0, 0};

static lockstep *touching(void) {
    simulation_config c = lockstep_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    insertion_wrench wrench = {.membrane = -1};
    assert_true(tip_touch(&l->simulation.insertion, &l->state, v3(0.005, 0.003, -0.001), v3(0.005, 0.003, 0.001), &wrench));
    assert_int_equal(wrench.events, EVENT_TOUCHED);
    return l;
}

static insertion_wrench go(lockstep *l, double slip) {
    insertion_wrench wrench = {.membrane = -1};
    l->state.tip.slip = slip;
    tip_move(&l->simulation.insertion, &l->state, NO_GRADIENT, &wrench);
    return wrench;
}

static insertion_wrench break_through(lockstep *l) {
    insertion_wrench wrench = {.membrane = -1};
    l->state.tip.slip = 1e-6;
    tip_puncture(&l->simulation.insertion, &l->state, &wrench);
    return wrench;
}

static bool in_its_element(const lockstep *l) {
    double w[4];
    mesh_barycentric(&l->simulation.mesh, l->state.tip.tet, l->state.tip.nominal, w);
    return w[0] > -1e-6 && w[1] > -1e-6 && w[2] > -1e-6 && w[3] > -1e-6;
}

static void skin_stops_it_until_punctured(void **unused) {
    (void)unused;
    lockstep *l = touching();
    assert_true(fabs(l->state.tip.nominal.z) < 1e-12);
    assert_true(tip_resistance(&l->simulation.insertion, &l->state.tip) == l->simulation.config.membranes[0].puncture_force);
    go(l, 0.01);
    assert_true(l->state.tip.depth == 0.0);
    assert_int_equal(break_through(l).membrane, 0);
    assert_true(tip_resistance(&l->simulation.insertion, &l->state.tip) == l->simulation.config.regions[1].material.cutting_force);
    go(l, 0.01);
    assert_true(fabs(l->state.tip.depth - 0.01) < 1e-6 && fabs(l->state.tip.nominal.z - 0.01) < 1e-6);
    lockstep_free(l);
}

/* The capsule is an ellipsoid of half axes 24, 17, 20 mm around (0, 0, 55) mm, in flat facets. */
static void capsule_stops_it_where_it_is(void **unused) {
    (void)unused;
    lockstep *l = touching();
    break_through(l);
    go(l, 0.06);
    double expected = 0.055 - 0.020 * sqrt(1.0 - pow(5.0 / 24.0, 2) - pow(3.0 / 17.0, 2));
    assert_int_equal(l->state.tip.blocked_by, 1);
    assert_true(fabs(l->state.tip.nominal.z - expected) < 2.5e-3);
    int outside = l->state.tip.tet;
    break_through(l);
    assert_int_not_equal(l->simulation.mesh.region[l->state.tip.tet], l->simulation.mesh.region[outside]);
    lockstep_free(l);
}

/* At the capsule, with so many layers noted already. */
static insertion_wrench into_the_gland_after(lockstep *l, int layers) {
    break_through(l);
    go(l, 0.06);
    for (int i = 0; i < layers; i++) l->state.strata[i] = (stratum){.depth = 0.0, .region = l->simulation.mesh.region[l->state.tip.tet]};
    l->state.stratum_count = layers;
    return break_through(l);
}

static void layers_that_find_no_room_are_told(void **unused) {
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

static void bone_is_never_entered(void **unused) {
    (void)unused;
    lockstep *l = touching();
    int gland = mesh_find_group(&l->simulation.mesh, "prostate", 3);
    l->simulation.materials[gland].cutting_force = INFINITY;
    break_through(l);
    go(l, 0.06);
    assert_int_equal(l->state.tip.blocked_by, BLOCKED_BY_BONE);
    assert_true(isinf(tip_resistance(&l->simulation.insertion, &l->state.tip)));
    assert_int_not_equal(l->simulation.mesh.region[l->state.tip.tet], gland);
    lockstep_free(l);
}

/* Nodes are left in order, no closer than the spacing, each on the track; the way back takes them up and ends outside. */
static void there_and_back(void **unused) {
    (void)unused;
    lockstep *l = touching();
    break_through(l);
    double spacing = l->simulation.insertion.settings.contact_spacing;
    for (int i = 0; i < 300; i++) {
        if (go(l, 1e-4), l->state.tip.blocked_by != NOT_BLOCKED) break_through(l);
        assert_true(in_its_element(l));
    }
    int left = contacts_passed(&l->state);
    assert_true(left >= 5);
    for (int i = 0; i < left; i++) {
        double z = l->state.refined.nodes[i].position.z;
        assert_true(fabs(z - l->state.contacts[i].depth) < 0.03 * 0.02 && z < l->state.tip.nominal.z + 1e-9);
        if (i > 0) assert_true(l->state.contacts[i].depth - l->state.contacts[i - 1].depth > spacing - 1e-12);
    }
    unsigned seen = 0;
    for (int i = 0; i < 400 && l->state.tip.phase == TIP_INSIDE; i++) {
        seen |= go(l, -1e-4).events;
        if (l->state.tip.phase == TIP_INSIDE) assert_true(in_its_element(l));
    }
    assert_int_equal(l->state.tip.phase, TIP_FREE);
    assert_int_equal(l->state.refined.count, 0);
    assert_true(seen & EVENT_REMOVED && seen & EVENT_WITHDRAWN);
    lockstep_free(l);
}

static void bevel_turns_the_cut_away_from_its_face(void **unused) {
    (void)unused;
    lockstep *l = touching();
    l->simulation.needle.given.bevel_slope = 0.1;
    break_through(l);
    go(l, 0.01);
    assert_true(fabs((l->state.tip.nominal.y - 0.003) / l->state.tip.nominal.z + 0.1) < 1e-6);
    lockstep_free(l);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(skin_stops_it_until_punctured), cmocka_unit_test(capsule_stops_it_where_it_is),
        cmocka_unit_test(layers_that_find_no_room_are_told),
        cmocka_unit_test(bone_is_never_entered),         cmocka_unit_test(there_and_back),
        cmocka_unit_test(bevel_turns_the_cut_away_from_its_face),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
