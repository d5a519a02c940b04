/* Tests through trocar.h that the force does not jump when moduli change during a run. */
#include "changing.h"

enum { KEYS = 6, N_CHANGES = 500 }; /* N_CHANGES: changes made with a still needle, and again with a moving one */
static const char *const KEY[KEYS] = {"regions[prostate].youngs_modulus", "regions[surrounding].youngs_modulus", "regions[prostate].stiffening",
                                      "membranes[skin].stiffness", "regions[prostate].friction.static", "regions[surrounding].cutting_force"};
static const double GIVEN[KEYS] = {60e3, 30e3, 0.0, 0.0, 15.0, 0.25};

static void set_some(trocar_change *c, unsigned *seed) {
    char lines[512] = "";
    for (int i = 0; i < KEYS; i++) {
        if (rand_r(seed) % 2) continue;
        double value = GIVEN[i] * pow(4.0, uniform(seed, -1, 1));
        if (GIVEN[i] == 0.0) value = uniform(seed, 0, strstr(KEY[i], "membranes") ? 200 : 3);
        snprintf(lines + strlen(lines), sizeof lines - strlen(lines), "%s: %.6g\n", KEY[i], value);
        if (strstr(KEY[i], "friction.static")) snprintf(lines + strlen(lines), sizeof lines - strlen(lines), "regions[prostate].friction.kinetic: %.6g\n", 0.6 * value);
    }
    if (lines[0] == '\0') snprintf(lines, sizeof lines, "%s: %.6g\n", KEY[0], GIVEN[0]);
    OK(trocar_change_set(c, lines, &why));
    OK(trocar_change_prepare(c, NULL, &why));
}

typedef struct { double largest, newton; int changes, ticks, punctures; } jumps;

/* Runs the motion with `count` changes of moduli, or with none if `changes` is 0. */
static jumps run(bool moves, double aside, int changes, int count, unsigned seed) {
    enum { RECOIL = 25, HOLD = 400, POOL = 24 }; /* POOL: number of prepared changes to draw from */
    jumps j = {0};
    trocar_sim *sim = sim_of(model);
    trocar_output last = push(sim, -1e-3, 0.045, 0.03);
    for (int i = 1; i <= 100; i++) last = step(sim, base_at(0.045, 0.01 * i * aside, 0));
    unsigned values = seed;
    int since = 0;
    trocar_change *pool[POOL];
    for (int k = 0; k < POOL; k++) {
        OK(trocar_change_create(sim, &pool[k], &why));
        if (changes) set_some(pool[k], &values);
    }
    for (int i = 0; i < count; i++) {
        if (changes) {
            OK(trocar_sim_change(sim, pool[rand_r(&values) % POOL], uniform(&values, TROCAR_CHANGE_TIME_LEAST, 0.3), &why));
            j.changes++;
        }
        int ticks = 0;
        while (ticks++ < (changes ? 5000 : HOLD) && (ticks < 20 || !changes || trocar_sim_changing(sim) > 0.0)) {
            double depth = 0.045 - (moves ? 3e-3 * (1 - cos(2 * M_PI * 1e-3 * j.ticks)) : 0.0); /* at most 19 mm/s */
            trocar_output out = step(sim, base_at(depth, aside, 0));
            if (out.events & (TROCAR_EVENT_UNSTABLE | TROCAR_EVENT_FULL)) fail_msg("tick %d: events %#x", j.ticks, out.events);
            since = out.events & (TROCAR_EVENT_PUNCTURED | TROCAR_EVENT_EXITED) ? 0 : since + 1;
            j.punctures += since == 0;
            double jump = distance(out.force, last.force), part = jump / noticed(last.force);
            if (since > RECOIL) j.newton = fmax(j.newton, jump), j.largest = fmax(j.largest, part);
            last = out;
            j.ticks++;
        }
    }
    for (int k = 0; k < POOL; k++) trocar_change_free(pool[k]);
    trocar_sim_free(sim);
    return j;
}

static void check_jumps(bool moves, double aside, unsigned seed) {
    jumps with = run(moves, aside, 1, N_CHANGES, seed), without = run(moves, aside, 0, N_CHANGES, seed);
    printf("%s%s needle: %d changes in %d ticks, %d punctures: largest change per tick %.3f of what is noticed, %.4f N; without changes %.3f, %.4f N\n", moves ? "moving" : "still", aside > 0.0 ? ", bent" : "",
           with.changes, with.ticks, with.punctures, with.largest, with.newton, without.largest, without.newton);
    assert_true(with.changes == N_CHANGES && with.largest < 1.0);
}

static void a_still_needle_feels_no_jump(void **state) { (void)state; check_jumps(false, 0.0, 3u); }
static void a_moving_needle_feels_no_jump(void **state) { (void)state; check_jumps(true, 0.0, 5u); }
static void a_bent_needle_feels_no_jump(void **state) { (void)state; check_jumps(false, 3e-3, 7u); }

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_still_needle_feels_no_jump),
        cmocka_unit_test(a_moving_needle_feels_no_jump),
        cmocka_unit_test(a_bent_needle_feels_no_jump),
    };
    return cmocka_run_group_tests(tests, build_figure8, discard);
}
