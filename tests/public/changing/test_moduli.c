/* Tests, through trocar.h, changing moduli, stiffening and membrane stiffness during a run. */
#include "changing.h"

static void wait(trocar_sim *sim, double depth) {
    for (int i = 0; trocar_sim_changing(sim) > 0.0; i++) {
        step_at(sim, depth);
        assert_true(i < 5000);
    }
}

/* ---- what a change does ------------------------------------------------------------------------------------------------------ */

static const char *const OTHER_KEYS[] = {"regions[prostate].youngs_modulus", "regions[surrounding].youngs_modulus", "membranes[skin].stiffness", "regions[prostate].stiffening"};
static const char *const OTHER_VALUES[] = {"20e3", "40e3", "100", "2"};
#define OTHER "regions[prostate].youngs_modulus: 20e3\nregions[surrounding].youngs_modulus: 40e3\nmembranes[skin].stiffness: 100\nregions[prostate].stiffening: 2"

/* If the change happens while the needle is outside the tissue, the results equal those of the changed scene, whose stiffness matrix is assembled and
   inverted from scratch. */
static void a_changed_simulation_is_that_of_the_changed_scene(void **state) {
    (void)state;
    trocar_model *built;
    trocar_sim *changed = sim_of(model), *other = sim_with(OTHER_KEYS, OTHER_VALUES, 4, &built);
    change(changed, OTHER, 0.1);
    wait(changed, -1e-3);
    double largest = 0.0, worst = 0.0;
    for (int i = 0; i < 1500; i++) {
        double depth = -1e-3 + 4e-5 * i;
        trocar_output a = step_at(changed, depth), b = step_at(other, depth);
        largest = fmax(largest, fabs(b.force[2]));
        worst = fmax(worst, distance(a.force, b.force));
    }
    printf("inserted after the change: largest difference %.2g of %.2f N\n", worst, largest);
    assert_true(largest > 1.0 && worst < 1e-9 * largest);
    trocar_sim_free(changed);
    trocar_sim_free(other);
    trocar_model_free(built);
}

/* As long as the shaft does not slide, a dent is elastic, so its force does not depend on when the moduli were changed. */
static void a_dent_has_the_force_of_the_new_moduli(void **state) {
    (void)state;
    trocar_model *built, *original;
    const char *const keys[] = {"regions[surrounding].friction.static", "regions[surrounding].friction.kinetic", OTHER_KEYS[0], OTHER_KEYS[1], OTHER_KEYS[2]};
    const char *const values[] = {"1e4", "1e4", OTHER_VALUES[0], OTHER_VALUES[1], OTHER_VALUES[2]};
    trocar_sim *changed = sim_with(keys, values, 2, &original), *other = sim_with(keys, values, 5, &built);
    push(changed, -1e-3, 1e-3, 0.01);
    double before = 0.0;
    for (int i = 0; i < 3000; i++) before = step_at(changed, 1e-3).force[2]; /* lets the dent settle */
    change(changed, "regions[prostate].youngs_modulus: 20e3\nregions[surrounding].youngs_modulus: 40e3\nmembranes[skin].stiffness: 100", 0.3);
    wait(changed, 1e-3);
    push(other, -1e-3, 1e-3, 0.01);
    trocar_output a, b;
    for (int i = 0; i < 3000; i++) a = step_at(changed, 1e-3), b = step_at(other, 1e-3);
    printf("dent of 1 mm: %.5f N before, %.9f N after the change, %.9f N if it is pressed afterwards\n", before, a.force[2], b.force[2]);
    assert_true(fabs(a.force[2] - before) > 0.1 * fabs(before) && fabs(a.force[2] - b.force[2]) < 1e-5 * fabs(b.force[2])); /* 1e-5: contact.tolerance / dent */
    /* changing the moduli back restores the original force */
    change(changed, "regions[prostate].youngs_modulus: 60e3\nregions[surrounding].youngs_modulus: 30e3\nmembranes[skin].stiffness: 0", 0.1);
    wait(changed, 1e-3);
    for (int i = 0; i < 3000; i++) a = step_at(changed, 1e-3);
    printf("and back: %.9f N, before %.9f N\n", a.force[2], before);
    assert_true(fabs(a.force[2] - before) < 1e-5 * fabs(before));
    trocar_sim_free(changed);
    trocar_sim_free(other);
    trocar_model_free(original);
    trocar_model_free(built);
}

/* If all moduli drop by the same factor, so does the force on a needle held still, even in relaxed tissue. */
static void the_force_is_proportional_to_the_moduli(void **state) {
    (void)state;
    for (int relaxes = 0; relaxes <= 1; relaxes++) {
        trocar_model *built;
        int ticks = relaxes ? RELAXED : SETTLED;
        trocar_sim *sim = sim_with(TWO_KEYS, TWO_VALUES, relaxes ? 5 : 1, &built);
        push(sim, -1e-3, 0.045, 0.03);
        trocar_output before, after;
        for (int i = 0; i < ticks; i++) before = step_at(sim, 0.045);
        change(sim, "regions[prostate].youngs_modulus: 30e3\nregions[surrounding].youngs_modulus: 15e3", 0.3);
        wait(sim, 0.045);
        double at_once = step_at(sim, 0.045).force[2];
        for (int i = 0; i < ticks; i++) after = step_at(sim, 0.045);
        printf("half the moduli: %.5f of %.5f N, %.5f, at once %.5f\n", after.force[2], before.force[2], after.force[2] / before.force[2], at_once / before.force[2]);
        assert_true(fabs(after.force[2] / before.force[2] - 0.5) < 1e-3 && fabs(at_once / before.force[2] - 0.5) < 5e-3);
        trocar_sim_free(sim);
        trocar_model_free(built);
    }
}

/* ---- resting needles ------------------------------------------------------------------------------------------------------------ */

/* A state saved while the moduli change around a resting needle continues in the same way wherever it is restored, and as if it had not been saved, within
   rounding errors. */
static void a_state_with_a_resting_needle_is_restored_during_a_change(void **state) {
    (void)state;
    trocar_model *built;
    const char *const keys[] = {"needles", "regions[prostate].stiffening", "regions[surrounding].stiffening"}, *const values[] = {"2", "1", "1"};
    trocar_sim *other = sim_with(keys, values, 3, &built), *third = sim_of(built), *sim = two_needles(built, SETTLED);
    change(sim, "regions[prostate].youngs_modulus: 40e3", 0.4);
    for (int t = 0; t < 150; t++) step_of(sim, 1, 0.012, 0.049);
    size_t size = trocar_sim_state_size(sim);
    void *saved = malloc(size);
    OK(trocar_sim_save(sim, saved, size, &why));
    OK(trocar_sim_restore(other, saved, trocar_state_bytes(saved), &why));
    OK(trocar_sim_restore(third, saved, trocar_state_bytes(saved), &why));
    assert_true(trocar_sim_changing(other) > 0.1);
    for (int t = 0; t < 500; t++) {
        trocar_output a = step_of(sim, 1, 0.012, 0.049), b = step_of(other, 1, 0.012, 0.049), c = step_of(third, 1, 0.012, 0.049);
        if (memcmp(&b, &c, sizeof b) != 0) fail_msg("tick %d: %.17g N, not %.17g", t, b.force[2], c.force[2]);
        if (distance(a.force, b.force) > 1e-9) fail_msg("tick %d: %.17g N, %.17g N without saving", t, b.force[2], a.force[2]);
    }
    assert_true(trocar_sim_changing(other) == 0.0);
    free(saved);
    trocar_sim_free(third);
    trocar_sim_free(other);
    trocar_sim_free(sim);
    trocar_model_free(built);
}

/* ---- refusals and saved states -------------------------------------------------------------------------------------------------- */

static void bad_changes_are_refused_without_effect(void **state) {
    (void)state;
    trocar_sim *sim = sim_of(model);
    trocar_change *c;
    OK(trocar_change_create(sim, &c, &why));
    assert_int_equal(trocar_change_set(c, "regions[prostate].poisson_ratio: 0.4", &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "regions[prostate].poisson_ratio: cannot change"));
    assert_int_equal(trocar_change_set(c, "regions[prostate].youngs_modulus: 0", &why), TROCAR_BAD_INPUT);
    assert_int_equal(trocar_change_prepared(c), 1);
    OK(trocar_change_set(c, "regions[prostate].youngs_modulus: 30e3", &why));
    assert_int_equal(trocar_change_prepared(c), 0);
    assert_int_equal(trocar_sim_change(sim, c, 0.2, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "trocar_change_prepare"));
    assert_true(trocar_sim_changing(sim) == 0.0);
    OK(trocar_change_prepare(c, NULL, &why));
    OK(trocar_sim_change(sim, c, 0.2, &why));
    push(sim, -1e-3, 1e-3, 0.02);
    OK(trocar_change_set(c, "regions[prostate].youngs_modulus: 90e3", &why));
    OK(trocar_change_prepare(c, NULL, &why));
    assert_int_equal(trocar_sim_accepts(sim, c), 0);
    assert_int_equal(trocar_sim_change(sim, c, 0.2, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "still moving"));
    wait(sim, 1e-3);
    assert_int_equal(trocar_sim_accepts(sim, c), 1);
    OK(trocar_sim_change(sim, c, 0.2, &why));
    trocar_change_free(c);
    trocar_sim_free(sim);
}

static void a_saved_state_contains_its_change(void **state) {
    (void)state;
    trocar_sim *sim = sim_of(model), *other = sim_of(model);
    push(sim, -1e-3, 0.03, 0.03);
    void *saved[3];
    for (int i = 0; i < 3; i++) {
        saved[i] = malloc(trocar_sim_state_size(sim));
        OK(trocar_sim_save(sim, saved[i], trocar_sim_state_size(sim), &why));
        if (i == 0) change(sim, OTHER, 0.4), push(sim, 0.03, 0.032, 0.02);
        if (i == 1) wait(sim, 0.032);
    }
    for (int k = 2; k >= 0; k--) {
        OK(trocar_sim_restore(sim, saved[k], trocar_state_bytes(saved[k]), &why));
        OK(trocar_sim_restore(other, saved[k], trocar_state_bytes(saved[k]), &why));
        assert_true(trocar_sim_changing(other) == trocar_sim_changing(sim) && (trocar_sim_changing(sim) > 0.1) == (k == 1));
        for (int i = 0; i < 500; i++) {
            trocar_output a = step_at(sim, 0.032 + 2e-5 * i), b = step_at(other, 0.032 + 2e-5 * i);
            if (memcmp(&a, &b, sizeof a) != 0) fail_msg("state %d, tick %d: %.17g N, not %.17g", k, i, a.force[2], b.force[2]);
        }
        free(saved[k]);
    }
    trocar_sim_free(sim);
    trocar_sim_free(other);
}

/* A reset does not undo a change, even one in progress: the next insertion feels the forces of the changed scene. */
static void a_reset_does_not_undo_a_change(void **state) {
    (void)state;
    trocar_model *built;
    trocar_pose start = base_at(-1e-3, 0, 0);
    trocar_sim *changed = sim_of(model), *other = sim_with(OTHER_KEYS, OTHER_VALUES, 4, &built), *given = sim_of(model);
    push(changed, -1e-3, 0.03, 0.03);
    change(changed, OTHER, 0.4);
    push(changed, 0.03, 0.032, 0.02);
    assert_true(trocar_sim_changing(changed) > 0.1);
    OK(trocar_sim_reset(changed, 0, &start, &why));
    assert_true(trocar_sim_changing(changed) > 0.1);
    wait(changed, -1e-3);
    double largest = 0.0, worst = 0.0, unlike = 0.0;
    for (int i = 0; i < 1500; i++) {
        double depth = -1e-3 + 4e-5 * i;
        trocar_output a = step_at(changed, depth), b = step_at(other, depth), c = step_at(given, depth);
        largest = fmax(largest, fabs(b.force[2]));
        worst = fmax(worst, distance(a.force, b.force));
        unlike = fmax(unlike, distance(c.force, b.force));
    }
    printf("inserted after a reset during the change: largest difference %.2g of %.2f N; from the scene before the change %.2g N\n", worst, largest, unlike);
    assert_true(worst < 1e-9 * largest && unlike > 0.05 * largest);
    trocar_sim_free(changed);
    trocar_sim_free(other);
    trocar_sim_free(given);
    trocar_model_free(built);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bad_changes_are_refused_without_effect),
        cmocka_unit_test(a_changed_simulation_is_that_of_the_changed_scene),
        cmocka_unit_test(a_dent_has_the_force_of_the_new_moduli),
        cmocka_unit_test(a_saved_state_contains_its_change),
        cmocka_unit_test(a_reset_does_not_undo_a_change),
        cmocka_unit_test(the_force_is_proportional_to_the_moduli),
        cmocka_unit_test(a_state_with_a_resting_needle_is_restored_during_a_change),
    };
    return cmocka_run_group_tests(tests, build_figure8, discard);
}
