/* Tests changes of moduli around a resting needle while the ultrasound probe presses on the tissue, through trocar.h. */
#include "changing.h"

typedef struct {
    trocar_output held;
    trocar_probe probe;
    double jump, resting_jump; /* N, largest change per tick during the changes: in the probe's force, and in a force on the resting needle */
    int count;
    trocar_contact resting[TROCAR_MAX_POINTS];
} beside_probe;

static trocar_output step_through(trocar_sim *sim, int needle, double x, double tip) {
    return step_needle(sim, needle, (trocar_pose){{x, 0, tip - LENGTH}, {1, 0, 0, 0}});
}

static void step_and_look(trocar_sim *sim, beside_probe *found) {
    found->held = step_through(sim, 1, 0.01, 0.06);
    found->probe = trocar_view_probe(trocar_sim_view(sim));
    found->count = trocar_view_contacts(trocar_sim_view(sim), 0, found->resting, TROCAR_MAX_POINTS);
}

static void change_and_watch(trocar_sim *sim, const char *lines, beside_probe *found) {
    step_and_look(sim, found);
    change(sim, lines, 0.3);
    for (int t = 0; trocar_sim_changing(sim) > 0.0 || t < 3000; t++) {
        beside_probe last = *found;
        step_and_look(sim, found);
        found->jump = fmax(found->jump, distance(found->probe.force, last.probe.force));
        for (int i = 0; i < found->count; i++) found->resting_jump = fmax(found->resting_jump, distance(found->resting[i].force, last.resting[i].force));
        assert_true(t < 10000);
    }
}

/* Presses the probe on the rectum, lets one needle rest in the gland, and holds a second one there. Then sets the values of `lines`, waits until the change is
   complete and the resting needle has followed it, and returns the forces. Finally raises the probe by another millimetre and sets the values of `restored`. */
static beside_probe with_probe(trocar_model *of, const char *lines, const char *restored) {
    beside_probe found = {.count = 0};
    trocar_sim *sim;
    OK(trocar_sim_create(of, &sim, &why));
    trocar_pose probe;
    assert_int_equal(trocar_model_probe_start(of, &probe), 1);
    for (int i = 0; i < 2; i++) {
        trocar_pose start = {{0.01 * i, 0, -0.03 - LENGTH}, {1, 0, 0, 0}};
        OK(trocar_sim_reset(sim, i, &start, &why));
        if (i == 0) {
            for (int t = 0; t < 40; t++) {
                probe.position[1] += 1e-4; /* by 4 mm in all; the first millimetre is free */
                OK(trocar_sim_set_probe(sim, &probe, &why));
                step_through(sim, 0, 0.0, -0.03);
            }
        }
        for (int t = 0; t <= 900; t++) step_through(sim, i, 0.01 * i, -0.03 + 1e-4 * t);
        for (int t = 0; t < 2000; t++) step_through(sim, i, 0.01 * i, 0.06);
        if (i == 0) let_go(sim);
    }
    change_and_watch(sim, lines, &found);
    beside_probe again = found;
    for (int t = 0; t < 100; t++) {
        probe.position[1] += 1e-5;
        OK(trocar_sim_set_probe(sim, &probe, &why));
        step_through(sim, 1, 0.01, 0.06);
    }
    change_and_watch(sim, restored, &again); /* the resting needle's forces have changed in the meantime */
    found.jump = again.jump;
    found.resting_jump = again.resting_jump;
    trocar_sim_free(sim);
    return found;
}

static double ratio(const double a[3], const double b[3]) { return (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) / (b[0] * b[0] + b[1] * b[1] + b[2] * b[2]); }

/* If all moduli fall to half, so do all forces on the probe, the held needle and the shaft of the resting one, compared with tissue that keeps its moduli
   around a needle and guides that are twice as stiff: elastic forces scale with the moduli as long as nothing slides. */
static void needles_beside_a_pressing_probe_follow_the_moduli(void **state) {
    (void)state;
    trocar_scene *other;
    trocar_model *built, *stiff;
    OK(trocar_scene_load(MESHES "/trus.yaml", &other, &why));
    OK(trocar_model_create(other, NULL, &built, &why));
    OK(trocar_scene_set(other, "needle.youngs_modulus", "4e11", &why));
    OK(trocar_scene_set(other, "guides[template].stiffness", "100e3", &why));
    OK(trocar_model_create(other, NULL, &stiff, &why));
    beside_probe unchanged = with_probe(stiff, "regions[prostate].friction.viscous: 101", "regions[prostate].friction.viscous: 100");
    beside_probe softer = with_probe(built, "regions[prostate].youngs_modulus: 17.5e3\nregions[surrounding].youngs_modulus: 12.5e3\n"
                                            "regions[perineum].youngs_modulus: 150e3\nregions[muscle].youngs_modulus: 25e3",
                                     "regions[prostate].youngs_modulus: 35e3\nregions[surrounding].youngs_modulus: 25e3\n"
                                     "regions[perineum].youngs_modulus: 300e3\nregions[muscle].youngs_modulus: 50e3");
    double largest = 0.0, worst = 0.0;
    assert_true(softer.count == unchanged.count && softer.count > 5);
    for (int i = 0; i < softer.count; i++) {
        const double *b = unchanged.resting[i].force, half[3] = {0.5 * b[0], 0.5 * b[1], 0.5 * b[2]};
        largest = fmax(largest, distance(half, (double[3]){0}));
        worst = fmax(worst, distance(softer.resting[i].force, half));
    }
    double held = ratio(softer.held.force, unchanged.held.force), probe = ratio(softer.probe.force, unchanged.probe.force);
    printf("half the moduli: probe %.4f of %.3f N, held needle %.4f of %.3f N, resting needle within %.5f of %.4f N; per tick, the probe's force changes by %.4f N, "
           "a force on the resting needle by %.5f N\n",
           probe, distance(unchanged.probe.force, (double[3]){0}), held, unchanged.held.force[2], worst, largest, softer.jump, softer.resting_jump);
    assert_true(unchanged.probe.contacts > 5 && fabs(probe - 0.5) < 5e-3 && fabs(held - 0.5) < 5e-3);
    assert_true(worst < 0.02 * largest && largest > 0.02);
    assert_true(softer.jump < 0.05 && softer.resting_jump < 0.05); /* just noticeable */
    trocar_model_free(built);
    trocar_model_free(stiff);
    trocar_scene_free(other);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(needles_beside_a_pressing_probe_follow_the_moduli),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
