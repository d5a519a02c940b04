/* Tests, through trocar.h, changing friction, cutting, puncture forces, calcifications and guides during a run. */
#include "changing.h"

/* Returns the figure-8 scene with a plate in front of the skin and a calcification in the needle's path, so that every kind of key that can change during a
   run is present. */
static trocar_scene *load_scene(void) {
    static const char *const keys[][2] = {
        {"guides[plate].origin", "[0.005, 0.003, -0.04]"}, {"guides[plate].normal", "[0, 0, 1]"}, {"guides[plate].hole_diameter", "1.5e-3"},
        {"guides[plate].thickness", "0.02"}, {"calcifications[0].centre", "[0.005, 0.003, 0.03]"}, {"calcifications[0].radius", "4e-3"},
        {"calcifications[0].cutting_factor", "2"}, {"regions[prostate].spreading_force", "0.1"}};
    trocar_scene *loaded;
    OK(trocar_scene_load(MESHES "/figure8.yaml", &loaded, &why));
    for (size_t i = 0; i < sizeof keys / sizeof *keys; i++) OK(trocar_scene_set(loaded, keys[i][0], keys[i][1], &why));
    return loaded;
}

static int build(void **state) {
    (void)state;
    scene = load_scene();
    OK(trocar_model_create(scene, NULL, &model, &why));
    return 0;
}

/* ---- no jump ---------------------------------------------------------------------------------------------------------------- */

/* Returns true for keys that are left to test_moduli.c. */
static bool needs_a_model(const char *key) {
    return strstr(key, "].youngs_modulus") || strstr(key, "].stiffening") || (strncmp(key, "membranes[", 10) == 0 && strstr(key, "].stiffness"));
}

/* Sets one to four random keys, each either to 0 or to 0.25-4 times the scene's value. Kinetic friction is kept below the static limit. */
static void set_some(trocar_change *c, const trocar_change *original, unsigned *seed) {
    char lines[1024] = "", key[TROCAR_CHANGE_KEY];
    int count = 1 + rand_r(seed) % 4;
    for (int i = 0; i < count; i++) {
        double value, other, factor = pow(4.0, uniform(seed, -1, 1)), added = 0.0, part = uniform(seed, 0, 1);
        int k;
        do k = rand_r(seed) % trocar_change_count(original);
        while (trocar_change_at(original, k, key, &value) && needs_a_model(key));
        bool zero = rand_r(seed) % 8 == 0;
        assert_int_equal(trocar_change_at(original, k, key, &value), 1);
        bool least_one = strstr(key, "cutting_factor"), is_static = strstr(key, "friction.static"), is_kinetic = strstr(key, "friction.kinetic");
        if (strstr(key, "spreading_force")) added = 0.2 * uniform(seed, 0, 1);
        if (zero && !least_one && !strstr(key, "stiffness")) factor = 0.0;
        value = value * factor + added;
        snprintf(lines + strlen(lines), sizeof lines - strlen(lines), "%s: %.6g\n", key, least_one ? fmax(value, 1.0) : value);
        if (!is_static && !is_kinetic) continue;
        assert_int_equal(trocar_change_at(original, is_static ? k + 1 : k - 1, key, &other), 1);
        assert_non_null(strstr(key, is_static ? "friction.kinetic" : "friction.static"));
        snprintf(lines + strlen(lines), sizeof lines - strlen(lines), "%s: %.6g\n", key, is_static ? part * value : value + 10.0 * part);
    }
    OK(trocar_change_set(c, lines, &why));
}

typedef struct {
    double largest;          /* largest change in force per tick, in just noticeable differences (tests/verification/verify_smoothness.c) */
    double newton;           /* N, the same */
    double caused;           /* largest difference in force from the same tick without the change of values, in the same units */
    int changes, ticks, compared, punctures;
} jumps;

/* Reference for the values while they change linearly, computed without the code under test. */
enum { MOST_KEYS = 32 };
typedef struct {
    char keys[MOST_KEYS][TROCAR_CHANGE_KEY];
    double from[MOST_KEYS], to[MOST_KEYS], time, since; /* s */
    int count;
} law;

static double now_of(const law *l, int i) { return l->from[i] + fmin(l->since / l->time, 1.0) * (l->to[i] - l->from[i]); }

static void take(law *l, const trocar_change *c, double time) {
    for (int i = 0; i < l->count; i++) l->from[i] = now_of(l, i);
    l->count = trocar_change_count(c);
    for (int i = 0; i < l->count; i++) assert_int_equal(trocar_change_at(c, i, l->keys[i], &l->to[i]), 1);
    l->time = time;
    l->since = 0.0;
}

/* Repeats the tick from `state`, but with the values frozen, and returns its output. */
static trocar_output frozen(trocar_sim *twin, const void *state, const law *l, trocar_pose base) {
    char lines[MOST_KEYS * 160] = "";
    size_t used = 0;
    for (int i = 0; i < l->count; i++) used += (size_t)snprintf(lines + used, sizeof lines - used, "%s: %.17g\n", l->keys[i], now_of(l, i));
    OK(trocar_sim_restore(twin, state, trocar_state_bytes(state), &why));
    change(twin, lines, TROCAR_CHANGE_TIME_MOST);
    return step(twin, base);
}

typedef struct {
    trocar_sim *sim, *twin;
    void *state;
    law values;
    trocar_output last;
    int since;               /* ticks since the last puncture or exit; its jump in force and the recoil are meant to be felt, so they are skipped */
    jumps result;
} trial;

/* Runs one tick. `counts`: whether the tick contributes to the result. */
static void tick(trial *t, trocar_pose base, bool counts) {
    static const int RECOIL = 25;
    jumps *j = &t->result;
    trocar_output before = t->last;
    bool moving = trocar_sim_changing(t->sim) > 0.0;
    if (moving) OK(trocar_sim_save(t->sim, t->state, trocar_sim_state_size(t->sim), &why));
    t->last = step(t->sim, base);
    j->ticks += counts;
    if (t->last.events & (TROCAR_EVENT_UNSTABLE | TROCAR_EVENT_FULL)) fail_msg("tick %d: events %#x", j->ticks, t->last.events);
    bool punctured = t->last.events & (TROCAR_EVENT_PUNCTURED | TROCAR_EVENT_EXITED);
    t->since = punctured ? 0 : t->since + 1;
    j->punctures += punctured;
    if (counts && t->since > RECOIL) {
        double jump = distance(t->last.force, before.force), part = jump / noticed(before.force);
        j->newton = fmax(j->newton, jump);
        j->largest = fmax(j->largest, part);
        if (moving && (part > 0.3 || j->ticks % 16 == 0)) {
            trocar_output same = frozen(t->twin, t->state, &t->values, base);
            j->caused = fmax(j->caused, distance(t->last.force, same.force) / noticed(before.force));
            j->compared++;
        }
    }
    t->values.since += DT;
}

/* Moves the needle between random positions in the tissue (`moves`) or holds it still at each, with or without changes. */
static jumps run(bool moves, bool changes, int count, unsigned seed) {
    trial t = {.sim = sim_of(model), .twin = sim_of(model), .since = 100};
    trocar_change *original, *c;
    OK(trocar_change_create(t.sim, &original, &why));
    take(&t.values, original, 1.0);
    memcpy(t.values.from, t.values.to, sizeof t.values.from);
    t.state = malloc(trocar_sim_state_size(t.sim));
    t.last = push(t.sim, -1e-3, 0.04, 0.03);
    double from[3] = {0.04, 0, 0};
    jumps *j = &t.result;
    unsigned hand = seed, values = seed + 1;
    while (j->changes < count) {
        bool goes = moves || j->changes % 25 == 0; /* even the still needle is moved now and then, because the force differs elsewhere */
        double to[3] = {uniform(&hand, 0.012, 0.07), uniform(&hand, -2e-3, 2e-3), uniform(&hand, -1.5, 1.5)};
        double seconds = fmax(0.2, 1.875 * fmax(fabs(to[0] - from[0]), fabs(to[1] - from[1])) / 0.03); /* at most 30 mm/s */
        int ticks = goes ? (int)ceil(seconds / DT) : 250, next = 0;
        for (int i = 1; i <= ticks; i++) {
            double s = (double)i / ticks, part = goes ? s * s * s * (10 + s * (6 * s - 15)) : 0.0, at[3];
            for (int k = 0; k < 3; k++) at[k] = from[k] + part * (to[k] - from[k]);
            if (i > next && j->changes < count) {
                double time = uniform(&values, TROCAR_CHANGE_TIME_LEAST, 0.5);
                OK(trocar_change_create(t.sim, &c, &why));
                set_some(c, original, &values);
                if (changes) {
                    OK(trocar_sim_change(t.sim, c, time, &why));
                    take(&t.values, c, time);
                }
                trocar_change_free(c);
                j->changes++;
                next = i + 50 + rand_r(&values) % 250; /* may replace a change that is still in progress */
            }
            tick(&t, base_at(at[0], at[1], at[2]), moves == goes);
        }
        if (goes) memcpy(from, to, sizeof from);
    }
    trocar_change_free(original);
    trocar_sim_free(t.sim);
    trocar_sim_free(t.twin);
    free(t.state);
    return t.result;
}

/* Random values can put friction far from the scene's, so a moving shaft may stick and slip even without a change. The effect of a change is therefore
   measured against the same tick with unchanged values. */
static void check_jumps(bool moves, unsigned seed) {
    jumps with = run(moves, true, 500, seed), without = run(moves, false, 500, seed);
    printf("%s needle: %d changes in %d ticks, %d punctures: largest change per tick %.3f of what is noticed, %.4f N; caused by changes %.3f (%d ticks); without changes "
           "%.3f, %.4f N\n", moves ? "moving" : "still", with.changes, with.ticks, with.punctures, with.largest, with.newton, with.caused, with.compared, without.largest,
           without.newton);
    assert_true(with.changes == 500 && with.ticks > 40000 && with.compared > 1000 && with.caused > 0.0);
    assert_true(with.caused < 0.25); /* a quarter of the just noticeable difference */
    if (!moves) assert_true(with.largest < 1.0);
}

static void a_still_needle_feels_no_jump(void **state) {
    (void)state;
    check_jumps(false, 1u);
}

static void a_moving_needle_feels_no_jump(void **state) {
    (void)state;
    check_jumps(true, 7u);
}

/* ---- what a change does ------------------------------------------------------------------------------------------------------ */

static const char *const HARDER[][2] = {{"regions[prostate].friction.static", "40"}, {"regions[prostate].friction.kinetic", "31"}, {"regions[surrounding].cutting_force", "0.8"},
                                        {"regions[surrounding].friction.viscous", "20"}, {"regions[prostate].cutting_viscosity", "3"}, {"membranes[capsule].puncture_force", "1.5"},
                                        {"calcifications[0].cutting_factor", "4"}, {"guides[plate].friction", "0.3"}, {"guides[plate].stiffness", "2e4"}};
enum { HARDER_COUNT = sizeof HARDER / sizeof *HARDER };

static void set_harder(trocar_sim *sim, double time) {
    char lines[1024] = "";
    for (int i = 0; i < HARDER_COUNT; i++) snprintf(lines + strlen(lines), sizeof lines - strlen(lines), "%s: %s\n", HARDER[i][0], HARDER[i][1]);
    change(sim, lines, time);
}

/* After a change, results are bit-identical to those of a scene that had the new values from the start. */
static void a_changed_simulation_is_that_of_the_changed_scene(void **state) {
    (void)state;
    trocar_scene *other;
    trocar_model *derived;
    OK(trocar_scene_copy(scene, &other, &why));
    for (int i = 0; i < HARDER_COUNT; i++) OK(trocar_scene_set(other, HARDER[i][0], HARDER[i][1], &why));
    OK(trocar_model_derive(model, other, &derived, &why));
    trocar_sim *changed = sim_of(model), *built = sim_of(derived), *untouched = sim_of(model);
    set_harder(changed, 0.1);
    assert_true(fabs(trocar_sim_changing(changed) - 0.1) < 1e-12);
    for (int i = 0; i < 100; i++) step_at(changed, -1e-3), step_at(built, -1e-3), step_at(untouched, -1e-3);
    assert_true(trocar_sim_changing(changed) == 0.0);
    bool differs = false;
    for (int i = 0; i < 2000; i++) {
        double depth = -1e-3 + 0.06 * (i < 1500 ? i / 1500.0 : 1.0 - (i - 1500) / 1000.0);
        trocar_pose base = base_at(depth, 1e-3 * sin(0.01 * i), 0.002 * i);
        trocar_output a = step(changed, base), b = step(built, base), c = step(untouched, base);
        if (memcmp(&a, &b, sizeof a) != 0) fail_msg("tick %d: %.17g N, not %.17g", i, a.force[2], b.force[2]);
        differs |= fabs(a.force[2] - c.force[2]) > 0.1;
    }
    assert_true(differs);
    trocar_sim_free(changed);
    trocar_sim_free(built);
    trocar_sim_free(untouched);
    trocar_model_free(derived);
    trocar_scene_free(other);
}

/* Friction on a sliding shaft is the kinetic limit integrated along it, so while the limit changes linearly, so does the force. */
static void friction_follows_its_ramp(void **state) {
    (void)state;
    trocar_sim *sim = sim_of(model);
    change(sim, "regions[prostate].friction.viscous: 0\nregions[surrounding].friction.viscous: 0\nregions[prostate].cutting_force: 0\nregions[surrounding].cutting_force: 0\n"
                "regions[prostate].spreading_force: 0\nregions[prostate].cutting_viscosity: 0\nregions[surrounding].cutting_viscosity: 0\nguides[plate].friction: 0", 0.1);
    push(sim, -1e-3, 0.07, 0.02);
    double before = push(sim, 0.07, 0.05, 0.02).force[2]; /* draws the needle back, so that friction is the only force */
    change(sim, "regions[prostate].friction.static: 5\nregions[prostate].friction.kinetic: 5\nregions[surrounding].friction.static: 5\nregions[surrounding].friction.kinetic: 5", 0.4);
    double at[5];
    for (int i = 0; i <= 4; i++) at[i] = i == 0 ? before : push(sim, 0.05 - 2e-4 * (i - 1), 0.05 - 2e-4 * i, 2e-3).force[2];
    double depth = 0.05 - 8e-4, end = 5.0 * depth; /* N, final force */
    printf("friction %.3f N falls to %.3f N in steps %.3f %.3f %.3f; at the end 5 N/m times %.1f mm: %.3f N\n", before, at[4], at[1], at[2], at[3], 1e3 * depth, end);
    assert_true(fabs(at[4] - end) < 0.03 * end);
    for (int i = 1; i < 4; i++) assert_true(fabs(at[i] - (before + 0.25 * i * (at[4] - before))) < 0.03 * fabs(before));
    trocar_sim_free(sim);
}

/* A membrane under a constant force is punctured once its limit has dropped to that force, and not before. */
static void a_held_membrane_breaks_at_the_force_on_it(void **state) {
    (void)state;
    trocar_sim *sim = sim_of(model);
    change(sim, "guides[plate].friction: 0", 0.1);
    for (int i = 0; i < 100; i++) step_at(sim, -1e-3);
    double depth = -1e-3;
    trocar_output out = {0};
    while (-out.force[2] < 0.45) out = step_at(sim, depth += 1e-5); /* the skin withstands 0.6 N */
    for (int i = 0; i < 500; i++) out = step_at(sim, depth);
    double held = -out.force[2];
    change(sim, "membranes[skin].puncture_force: 0.3", 0.5);
    int ticks = 0;
    for (; ticks < 500 && !(out.events & TROCAR_EVENT_PUNCTURED); ticks++) out = step_at(sim, depth);
    double limit = 0.6 - 0.3 * ticks / 500;
    printf("held at %.3f N, broken when the limit was %.3f N\n", held, limit);
    assert_true(ticks < 500 && fabs(limit - held) < 0.02);
    trocar_sim_free(sim);
}

/* If 80 ms pass between two ticks, the values still advance by no more than a fiftieth of the change in one tick. */
static void a_late_tick_does_not_catch_up(void **state) {
    (void)state;
    trocar_sim *sim = sim_of(model);
    push(sim, -1e-3, 0.05, 0.03);
    trocar_pose base = base_at(0.05, 0, 0);
    trocar_output before = {0}, late;
    for (int i = 0; i < 300; i++) before = step(sim, base);
    change(sim, "regions[prostate].friction.static: 0\nregions[prostate].friction.kinetic: 0\nregions[surrounding].friction.static: 0\nregions[surrounding].friction.kinetic: 0", 0.1);
    OK(trocar_sim_step(sim, 0, &base, 0.08, &late, &why));
    assert_true(fabs(trocar_sim_changing(sim) - 0.098) < 1e-9);
    assert_true(distance(late.force, before.force) < noticed(before.force));
    for (int i = 0; i < 300; i++) late = step(sim, base);
    assert_true(trocar_sim_changing(sim) == 0.0 && distance(late.force, before.force) > 2.0 * noticed(before.force));
    trocar_sim_free(sim);
}

/* ---- refusals ---------------------------------------------------------------------------------------------------------------- */

static void bad_changes_are_refused_without_effect(void **state) {
    (void)state;
    static const struct { const char *lines, *words; } bad[] = {
        {"regions[prostate].poisson_ratio: 0.4", "regions[prostate].poisson_ratio: cannot change during a run"},
        {"needle.length: 0.1", "needle.length: cannot change during a run"},
        {"rate_hz: 500", "cannot change during a run"},
        {"membranes[skin].name: capsule", "cannot change during a run"},
        {"membranes[other].puncture_force: 1", "no such entry"},
        {"membranes[7].puncture_force: 1", "no such entry"},
        {"membranes[skin].puncture: 1", "no key"},
        {"membranes[skin].puncture_force: -1", "at least 0"},
        {"membranes[skin].puncture_force: hard", "at least 0"},
        {"membranes[skin].puncture_force: .nan", "at least 0"},
        {"membranes[skin].puncture_force: .inf", "bone"},
        {"regions[prostate].cutting_force: .inf", "bone"},
        {"calcifications[0].cutting_factor: 0.5", "at least 1"},
        {"guides[plate].stiffness: 0", "above 0"},
        {"regions[prostate].friction.kinetic: 16", "exceeds the static limit"},
        {"membranes[skin].puncture_force: 1\nregions[prostate].friction.static: 3", "exceeds the static limit"},
        {"membranes[skin].puncture_force", "key: value"},
        {"membranes[skin].puncture_force: ", "membranes[skin].puncture_force"},
        {"", "nothing"},
        {"\n \n", "nothing"},
        {":", "empty"},
    };
    trocar_sim *sim = sim_of(model), *same = sim_of(model);
    trocar_change *c, *none;
    char key[TROCAR_CHANGE_KEY], known[TROCAR_CHANGE_KEY];
    double value, expected;
    OK(trocar_change_create(sim, &c, &why));
    OK(trocar_change_create(sim, &none, &why));
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        trocar_status status = trocar_change_set(c, bad[i].lines, &why);
        if (status != TROCAR_BAD_INPUT || !strstr(why.text, bad[i].words)) fail_msg("\"%s\": status %d, %s", bad[i].lines, status, why.text);
    }
    char lengthy[600];
    memset(lengthy, 'x', sizeof lengthy - 1);
    lengthy[sizeof lengthy - 1] = '\0';
    assert_int_equal(trocar_change_set(c, lengthy, &why), TROCAR_BAD_INPUT);
    for (int i = 0; i < trocar_change_count(c); i++) {
        assert_true(trocar_change_at(c, i, key, &value) && trocar_change_at(none, i, known, &expected));
        assert_true(strcmp(key, known) == 0 && value == expected);
    }
    assert_int_equal(trocar_change_at(c, -1, key, &value) + trocar_change_at(c, trocar_change_count(c), key, &value), 0);
    static const double times[] = {0.0, -1.0, 0.05, 61.0, NAN, INFINITY};
    for (size_t i = 0; i < sizeof times / sizeof *times; i++) assert_int_equal(trocar_sim_change(sim, c, times[i], &why), TROCAR_BAD_INPUT);
    OK(trocar_sim_change(sim, c, 0.1, &why)); /* changes nothing */
    for (int i = 0; i < 1000; i++) {
        trocar_output a = step_at(sim, -1e-3 + 4e-5 * i), b = step_at(same, -1e-3 + 4e-5 * i);
        assert_memory_equal(&a, &b, sizeof a);
    }
    trocar_scene *soft;
    trocar_model *other;
    OK(trocar_scene_copy(scene, &soft, &why));
    OK(trocar_scene_set(soft, "membranes[skin].puncture_force", "1", &why));
    OK(trocar_model_derive(model, soft, &other, &why));
    trocar_sim *stranger = sim_of(other);
    assert_int_equal(trocar_sim_change(stranger, c, 0.5, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "another model"));
    trocar_sim_free(stranger);
    trocar_model_free(other);
    trocar_scene_free(soft);
    trocar_change_free(c);
    trocar_change_free(none);
    trocar_sim_free(sim);
    trocar_sim_free(same);
}

static void the_keys_are_those_of_the_scene(void **state) {
    (void)state;
    trocar_sim *sim = sim_of(model);
    trocar_change *c;
    char key[TROCAR_CHANGE_KEY];
    double value, expected;
    OK(trocar_change_create(sim, &c, &why));
    assert_int_equal(trocar_change_count(c), 2 * 8 + 2 * 2 + 1 + 2);
    for (int i = 0; i < trocar_change_count(c); i++) {
        assert_int_equal(trocar_change_at(c, i, key, &value), 1);
        OK(trocar_scene_get_number(scene, key, &expected, &why));
        assert_true(value == expected);
    }
    OK(trocar_change_set(c, "membranes[1].puncture_force: 2", &why)); /* entries can also be given by index */
    OK(trocar_sim_change(sim, c, 0.1, &why));
    trocar_change *later; /* starts out with the simulation's current values */
    OK(trocar_change_create(sim, &later, &why));
    bool found = false;
    for (int i = 0; trocar_change_at(later, i, key, &value); i++) found |= strcmp(key, "membranes[capsule].puncture_force") == 0 && value == 2.0;
    assert_true(found);
    trocar_change_free(later);
    trocar_change_free(c);
    trocar_sim_free(sim);
}

/* ---- saved states ------------------------------------------------------------------------------------------------------------ */

static void a_saved_state_contains_its_change(void **state) {
    (void)state;
    trocar_sim *sim = sim_of(model), *other = sim_of(model);
    push(sim, -1e-3, 0.03, 0.03);
    void *unchanged = malloc(trocar_sim_state_size(sim)), *amid = malloc(trocar_sim_state_size(sim));
    OK(trocar_sim_save(sim, unchanged, trocar_sim_state_size(sim), &why));
    set_harder(sim, 0.3);
    push(sim, 0.03, 0.032, 0.02); /* a third of the change's duration */
    OK(trocar_sim_save(sim, amid, trocar_sim_state_size(sim), &why));
    OK(trocar_sim_restore(other, amid, trocar_state_bytes(amid), &why));
    assert_true(trocar_sim_changing(other) == trocar_sim_changing(sim) && trocar_sim_changing(sim) > 0.1);
    for (int i = 0; i < 600; i++) {
        trocar_pose base = base_at(0.032 + 3e-5 * i, 0, 0);
        trocar_output a = step(sim, base), b = step(other, base);
        assert_memory_equal(&a, &b, sizeof a);
    }
    OK(trocar_sim_restore(sim, unchanged, trocar_state_bytes(unchanged), &why)); /* the change is undone */
    OK(trocar_sim_restore(other, unchanged, trocar_state_bytes(unchanged), &why));
    trocar_sim *fresh = sim_of(model);
    OK(trocar_sim_restore(fresh, unchanged, trocar_state_bytes(unchanged), &why));
    assert_true(trocar_sim_changing(sim) == 0.0);
    for (int i = 0; i < 300; i++) {
        trocar_pose base = base_at(0.03 + 3e-5 * i, 0, 0);
        trocar_output a = step(sim, base), b = step(fresh, base);
        assert_memory_equal(&a, &b, sizeof a);
    }
    free(unchanged);
    free(amid);
    trocar_sim_free(sim);
    trocar_sim_free(other);
    trocar_sim_free(fresh);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_still_needle_feels_no_jump),
        cmocka_unit_test(a_moving_needle_feels_no_jump),
        cmocka_unit_test(a_changed_simulation_is_that_of_the_changed_scene),
        cmocka_unit_test(friction_follows_its_ramp),
        cmocka_unit_test(a_held_membrane_breaks_at_the_force_on_it),
        cmocka_unit_test(a_late_tick_does_not_catch_up),
        cmocka_unit_test(bad_changes_are_refused_without_effect),
        cmocka_unit_test(the_keys_are_those_of_the_scene),
        cmocka_unit_test(a_saved_state_contains_its_change),
    };
    return cmocka_run_group_tests(tests, build, discard);
}
