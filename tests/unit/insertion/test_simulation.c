/* Tests restoring a saved state, into the same simulation after other motions or into another one. The results that follow must be bit-identical. */
#include "lockstep.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

enum { MARKS = 12 };
typedef struct { vec3 force[MARKS], torque[MARKS]; double depth[MARKS]; } recorded;

/* Moves the needle sideways, deeper, back past contact nodes and in again, so that nodes are added and removed. */
static recorded go_on(lockstep *l) {
    static const double way[MARKS][3] = {{1, 2, 4}, {0, 0, 4}, {-1, 0, -3}, {0, 0, -5}, {0, 1, -4}, {0, 0, 6},
                                         {0, 0, 6}, {1, -2, 5}, {0, 0, -4}, {0, 0, 3}, {0, 0, 5}, {0, 0, -20}};
    recorded r;
    memset(&r, 0, sizeof r);
    for (int i = 0; i < MARKS; i++) {
        lockstep_move(l, v3(1e-3 * way[i][0], 1e-3 * way[i][1], 1e-3 * way[i][2]), 0.1, 1e-3);
        r.force[i] = l->wrench.force;
        r.torque[i] = l->wrench.torque;
        r.depth[i] = l->wrench.depth;
    }
    return r;
}

static void restore(lockstep *l, const checkpoint *saved) {
    trocar_error why;
    assert_int_equal(run_restore(&l->run, saved, &l->state, l->snapshot, &why), TROCAR_OK);
    l->base = l->state.needle.base;
}

/* Moves from the same point along another path that adds as many nodes, so that node numbers are reused. */
static void make_a_detour(lockstep *l) {
    lockstep_move(l, v3(-0.003, 0.004, 0.012), 0.3, 1e-3);
    lockstep_move(l, v3(0, 0, -0.030), 0.3, 1e-3);
}

static double largest_difference(const recorded *a, const recorded *b) {
    double largest = 0.0;
    for (int i = 0; i < MARKS; i++) largest = fmax(largest, v3_norm(v3_sub(a->force[i], b->force[i])));
    return largest;
}

static lockstep *inserted_by(remesh_method method, const simulation_config *config) {
    lockstep *l = lockstep_create(config, lockstep_start());
    lockstep_remesh_by(l, method);
    lockstep_move(l, v3(0, 0, 0.050), 0.8, 1e-3);
    lockstep_move(l, v3(0.001, 0, -0.006), 0.2, 1e-3);
    return l;
}

static lockstep *inserted(const simulation_config *config) { return inserted_by(REMESH_NESTED, config); }

static void restored_simulation_continues_bit_identically(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    c.needle.bevel_slope = 0.05;
    lockstep *l = inserted(&c), *other = lockstep_create(&c, lockstep_start());
    checkpoint *saved = malloc(sizeof *saved);
    run_save(&l->state, l->snapshot, saved);
    recorded once = go_on(l);
    assert_true(v3_norm(once.force[0]) > 0.1);

    restore(l, saved);
    make_a_detour(l);
    restore(l, saved);
    recorded again = go_on(l);
    assert_memory_equal(&once, &again, sizeof once);

    restore(other, saved);
    recorded elsewhere = go_on(other);
    assert_memory_equal(&once, &elsewhere, sizeof once);
    free(saved);
    lockstep_free(other);
    lockstep_free(l);
}

static void restored_at_rest_engages_again(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    checkpoint *saved = malloc(sizeof *saved);
    run_save(&l->state, l->snapshot, saved);
    lockstep_move(l, v3(0, 0, 0.04), 0.5, 1e-3);
    tick_output once = l->wrench;
    restore(l, saved);
    lockstep_move(l, v3(0, 0, 0.04), 0.5, 1e-3);
    assert_memory_equal(&once.force, &l->wrench.force, sizeof once.force);
    free(saved);
    lockstep_free(l);
}

/* Bit-identical for `nested` with a stored inverse; otherwise, equal except for rounding errors. */
static void every_method_and_inverse_can_be_restored(void **unused) {
    (void)unused;
    char directory[] = "/tmp/test_simulation.XXXXXX", command[64];
    assert_non_null(mkdtemp(directory));
    static const struct { remesh_method method; inverse_choice owner; bool exact; } cases[] = {
        {REMESH_NESTED, INVERSE_DENSE, true}, {REMESH_NESTED, INVERSE_CONDENSED, true}, {REMESH_NESTED, INVERSE_SPARSE, false},
        {REMESH_IMPLICIT, INVERSE_DENSE, false}, {REMESH_IMPLICIT, INVERSE_SPARSE, false},
        {REMESH_WOODBURY, INVERSE_DENSE, false}, {REMESH_WOODBURY_GENERAL, INVERSE_DENSE, false},
        {REMESH_BCS, INVERSE_DENSE, false}, {REMESH_BCS_BLOCKED, INVERSE_DENSE, false},
    };
    checkpoint *saved = malloc(sizeof *saved);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        simulation_config c = lockstep_config();
        c.inverse = cases[i].owner;
        strcpy(c.cache, directory);
        lockstep *l = inserted_by(cases[i].method, &c);
        run_save(&l->state, l->snapshot, saved);
        recorded once = go_on(l);
        restore(l, saved);
        make_a_detour(l);
        restore(l, saved);
        recorded again = go_on(l);
        if (cases[i].exact) assert_memory_equal(&once, &again, sizeof once);
        else assert_true(largest_difference(&once, &again) < 1e-9);
        lockstep_free(l);
    }
    free(saved);
    snprintf(command, sizeof command, "rm -r %s", directory);
    assert_int_equal(system(command), 0);
}

/* For the same motion, every kind of inverse gives the same forces and reports its own kind. */
static void every_inverse_gives_the_same_forces(void **unused) {
    (void)unused;
    char directory[] = "/tmp/test_simulation.XXXXXX", command[64];
    assert_non_null(mkdtemp(directory));
    static const struct { inverse_choice choice; double radius; const char *words; } cases[] = {
        {INVERSE_AUTO, 0.02, "dense (572 nodes: 0.0158 GB)"}, {INVERSE_SPARSE, 0.02, "sparse (set in the scene)"}, {INVERSE_SPARSE, 0, "sparse"},
        {INVERSE_CONDENSED, 0.02, "condensed (set in the scene): "}, {INVERSE_CONDENSED, 0.003, "condensed"}, {INVERSE_CONDENSED, 0.0, "condensed"},
    };
    recorded dense, other;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        simulation_config config = lockstep_config();
        config.inverse = cases[i].choice;
        config.roi.radius = cases[i].radius; /* so narrow that the needle leaves the region */
        config.roi.from = v3(0.005, 0.003, 0);
        config.roi.to = v3(0.005, 0.003, 0.1);
        strcpy(config.cache, directory);
        lockstep *l = inserted(&config);
        if (strncmp(l->parts.about_inverse.text, cases[i].words, strlen(cases[i].words)) != 0)
            fail_msg("\"%s\" where \"%s\" was expected", l->parts.about_inverse.text, cases[i].words);
        other = go_on(l);
        lockstep_free(l);
        if (i == 0) dense = other;
        else assert_true(largest_difference(&dense, &other) < 1e-6);
    }
    snprintf(command, sizeof command, "rm -r %s", directory);
    assert_int_equal(system(command), 0);
}

/* As in the server, a tick whose state is not finite returns no force, and the insertion restarts at the needle's position. */
static void non_finite_state_restarts(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    lockstep *l = inserted(&c);
    double depth = l->wrench.depth;
    l->state.contacts[2].shaft.slip = NAN;
    lockstep_move(l, v3(0, 0, 0.0001), 1e-3, 1e-3);
    assert_true(l->wrench.events & EVENT_UNSTABLE);
    assert_true(v3_norm(l->wrench.force) == 0.0 && v3_norm(l->wrench.torque) == 0.0);
    for (int i = 0; i < 100; i++) {
        lockstep_move(l, v3(0, 0, 0.0001), 1e-3, 1e-3);
        assert_true(insertion_is_finite(&l->state, &l->wrench));
    }
    assert_false(l->wrench.events & EVENT_UNSTABLE);
    assert_true(l->wrench.depth > depth && l->wrench.depth < depth + 0.0105); /* the base advanced by 10.1 mm, and the tissue gave way by part of that */
    assert_true(v3_norm(l->wrench.force) > 0.1);
    lockstep_free(l);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(non_finite_state_restarts),
        cmocka_unit_test(restored_simulation_continues_bit_identically),
        cmocka_unit_test(restored_at_rest_engages_again),
        cmocka_unit_test(every_method_and_inverse_can_be_restored),
        cmocka_unit_test(every_inverse_gives_the_same_forces),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
