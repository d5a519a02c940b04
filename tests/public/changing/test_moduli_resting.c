/* Tests changes of moduli around a resting needle beside a held one, through trocar.h. */
#include "changing.h"

typedef struct {
    trocar_output held;
    double jump;             /* largest change in force per tick on the held needle, in just noticeable differences */
    int count;
    trocar_contact contacts[TROCAR_MAX_POINTS];
} both_needles;
typedef enum { RESTS, LEFT_MEANWHILE, HELD } during_change; /* what the first needle does while the moduli change */

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

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_resting_needle_follows_the_moduli),
        cmocka_unit_test(a_needle_that_rests_in_relaxed_tissue_follows_the_moduli),
    };
    return cmocka_run_group_tests(tests, build_figure8, discard);
}
