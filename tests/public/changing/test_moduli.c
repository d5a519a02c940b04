/* Tests, through trocar.h, changing moduli, stiffening and membrane stiffness during a run. */
#include "changing.h"

static void wait(trocar_sim *sim, double depth) {
    for (int i = 0; trocar_sim_changing(sim) > 0.0; i++) {
        step_at(sim, depth);
        assert_true(i < 5000);
    }
}

static trocar_sim *sim_with(const char *const keys[], const char *const values[], int count, trocar_model **built) {
    trocar_scene *other;
    OK(trocar_scene_copy(scene, &other, &why));
    for (int i = 0; i < count; i++) OK(trocar_scene_set(other, keys[i], values[i], &why));
    OK(trocar_model_create(other, NULL, built, &why));
    trocar_scene_free(other);
    return sim_of(*built);
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

/* The first key alone makes a scene with two needles; with all keys, the tissue also relaxes. */
static const char *const TWO_KEYS[] = {"needles", "relaxation[0].weight", "relaxation[0].time", "relaxation[1].weight", "relaxation[1].time"};
static const char *const TWO_VALUES[] = {"2", "0.25", "0.15", "0.15", "0.5"};

enum { SETTLED = 300, RELAXED = 5000 }; /* ticks that a needle is held: until elastic tissue has settled; ten times the longest relaxation time constant */

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

static trocar_output step_of(trocar_sim *sim, int needle, double x, double depth) {
    trocar_pose base = {{x, 0.003, depth - LENGTH}, {1, 0, 0, 0}};
    trocar_output out;
    OK(trocar_sim_step(sim, needle, &base, DT, &out, &why));
    return out;
}

typedef struct {
    trocar_output held;
    double jump;             /* largest change in force per tick on the held needle, in just noticeable differences */
    int count;
    trocar_contact contacts[TROCAR_MAX_POINTS];
} both_needles;
typedef enum { RESTS, LEFT_MEANWHILE, HELD } during_change; /* what the first needle does while the moduli change */

/* Lets one needle rest in the tissue, inserts another 6 mm away, and holds that one pressed to the side. */
static trocar_sim *two_needles(trocar_model *of, int ticks) {
    trocar_sim *sim;
    OK(trocar_sim_create(of, &sim, &why));
    for (int i = 0; i < 2; i++) {
        trocar_pose start = {{0.005 + 0.006 * i, 0.003, -1e-3 - LENGTH}, {1, 0, 0, 0}};
        OK(trocar_sim_reset(sim, i, &start, &why));
        for (int t = 0; t <= 500; t++) step_of(sim, i, start.position[0], -1e-3 + 1e-4 * t);
        if (i > 0) break;
        for (int t = 0; t < ticks; t++) step_of(sim, 0, 0.0055, 0.049); /* displaced sideways, so that relaxing tissue remembers a lateral load */
        let_go(sim);
    }
    for (int t = 0; t < 200; t++) step_of(sim, 1, 0.011 + 5e-6 * t, 0.049);
    for (int t = 0; t < ticks; t++) step_of(sim, 1, 0.012, 0.049);
    return sim;
}

static both_needles after_change(trocar_model *of, int ticks, const char *lines, during_change first) {
    both_needles found = {.count = 0};
    trocar_sim *sim = two_needles(of, ticks);
    trocar_pose base = trocar_view_base(trocar_sim_view(sim), 0);
    bool held = first != RESTS;
    if (held) {
        OK(trocar_sim_take(sim, 0, &why));
        OK(trocar_sim_work(sim, NULL, &why));
    }
    double x = 0.012;
    found.held = step_of(sim, 1, x, 0.049);
    change(sim, lines, 0.2);
    for (int t = 0; trocar_sim_changing(sim) > 0.0; t++) {
        trocar_output ignored, last = found.held;
        if (t == 100 && first == LEFT_MEANWHILE) let_go(sim), held = false;
        if (held) OK(trocar_sim_step(sim, 0, &base, DT, &ignored, &why));
        found.held = step_of(sim, 1, x = fmax(x - 4e-6, 0.0115), 0.049); /* the held needle moves sideways during the change */
        found.jump = fmax(found.jump, distance(found.held.force, last.force) / noticed(last.force));
    }
    if (held) let_go(sim);
    for (int t = 0; t < ticks; t++) found.held = step_of(sim, 1, 0.0115, 0.049);
    found.count = trocar_view_contacts(trocar_sim_view(sim), 0, found.contacts, TROCAR_MAX_POINTS);
    trocar_sim_free(sim);
    return found;
}

#define SOFTER "regions[prostate].youngs_modulus: 40e3\nregions[surrounding].youngs_modulus: 20e3"

/* Checks that the forces are `part` times the expected ones. */
static void compare(const both_needles *found, const both_needles *expected, double part) {
    double worst = 0.0, largest = 0.0;
    assert_true(found->count == expected->count && found->count > 5);
    for (int i = 0; i <= found->count; i++) {
        const double *a = i < found->count ? found->contacts[i].force : found->held.force, *b = i < found->count ? expected->contacts[i].force : expected->held.force;
        const double scaled[3] = {part * b[0], part * b[1], part * b[2]};
        worst = fmax(worst, distance(a, scaled));
        if (i < found->count) largest = fmax(largest, distance(a, (double[3]){0}));
    }
    printf("resting needle: largest contact force %.4f N; held needle: %.4f N; largest difference %.5f N; jumps %.3f\n", largest, found->held.force[2], worst, found->jump);
    assert_true(worst < 2e-3 && largest > 0.1 && found->jump < 1.0);
}

/* As long as nothing slides, it must make no difference whether the needle rested while the moduli changed, or was held and released afterwards. The two
   cases take different code paths: a held needle's equilibrium is solved in every tick, a resting needle's follows from a linear response. Softer tissue
   lowers the forces, so nothing starts to slide. After a release, up to 1 mN remains at the base and is taken up by the contacts. */
static void a_resting_needle_follows_the_moduli(void **state) {
    (void)state;
    trocar_model *built;
    trocar_sim_free(sim_with(TWO_KEYS, TWO_VALUES, 1, &built));
    both_needles expected = after_change(built, SETTLED, SOFTER, HELD), rested = after_change(built, SETTLED, SOFTER, RESTS),
                 left = after_change(built, SETTLED, SOFTER, LEFT_MEANWHILE);
    compare(&rested, &expected, 1.0);
    compare(&left, &expected, 1.0);
    trocar_model_free(built);
}

/* In relaxed tissue, up to 20 mN remains at the base of a released needle, so the forces are compared with those of a run without the change. The needle is
   much stiffer than the tissue, so the forces drop by the same factor as the moduli. */
static void a_needle_that_rests_in_relaxed_tissue_follows_the_moduli(void **state) {
    (void)state;
    trocar_model *built;
    trocar_sim_free(sim_with(TWO_KEYS, TWO_VALUES, 5, &built));
    both_needles unchanged = after_change(built, RELAXED, "regions[prostate].friction.viscous: 100", RESTS),
                 rested = after_change(built, RELAXED, SOFTER, RESTS);
    compare(&rested, &unchanged, 2.0 / 3.0);
    trocar_model_free(built);
}

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
        cmocka_unit_test(a_resting_needle_follows_the_moduli),
        cmocka_unit_test(a_needle_that_rests_in_relaxed_tissue_follows_the_moduli),
        cmocka_unit_test(a_state_with_a_resting_needle_is_restored_during_a_change),
    };
    return cmocka_run_group_tests(tests, build_figure8, discard);
}
