/* Measures how late the worker is on a mesh where it never is, and at a tick period so short that it always is. */
#include "host.h"
#include "sanitized.h"
#include "scale_timing.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static const double ASIDE = 1e-3; /* m, lateral offset at which the needle crosses no element so close to an edge that it leaves it within one tick */

static const double WHOLE = 0.066; /* m, depth of an insertion through several elements */
static const double ABOVE = 1e-3; /* m, how far above the skin the tip starts */

static scale_timing *measured(double aside, const motion *script, double speed, double depth, double dt, const char *owner) {
    host h = {NULL};
    trocar_error why;
    static scale_timing result;
    assert_int_equal(trocar_scene_load(MESHES "/figure8.yaml", &h.scene, &why), TROCAR_OK);
    assert_int_equal(trocar_scene_set(h.scene, "inverse", owner, &why), TROCAR_OK);
    assert_int_equal(trocar_model_create(h.scene, NULL, &h.model, &why), TROCAR_OK);
    assert_int_equal(trocar_sim_create(h.model, &h.sim, &why), TROCAR_OK);
    pose start = {{0.005 + aside, 0.003, -0.2 - ABOVE}, {1, 0, 0, 0}};
    scale_case wanted = {.start = start, .script = script, .speed = speed, .depth = depth, .dt = dt};
    assert_int_equal(scale_timing_measure(h.sim, &wanted, &result, &why), TROCAR_OK);
    host_close(&h);
    return &result;
}

/* Checks that every request for a contact node was answered once or counted as unanswered, and that those for all active nodes were answered. */
static void check_counts(const scale_timing *r) {
    assert_int_equal(r->crossing.count + r->unanswered, r->contacts);
    assert_in_range(r->activation.count, r->most_contacts, r->crossing.count);
}

static void crossings_are_counted_and_answered(void **unused) {
    (void)unused;
    const scale_timing *r = measured(ASIDE, NULL, 0.02, WHOLE, 1e-3, "dense");
    assert_int_equal(r->ticks, 3300);
    assert_int_equal(r->tick.count, 3300);
    check_counts(r);
    if (SANITIZED) return; /* the worker is too slow for the following checks: measuring the mesh's resolution takes it several ticks */
    assert_true(r->crossings > 5 && r->contacts > 5);
    assert_true(r->unanswered <= 1); /* the last node may have been requested in the last tick */
    assert_true(r->activation.max == 0 && r->late_crossings == 0); /* all nodes were active before the tip left their elements */
    assert_true(r->serve.count >= r->crossings && r->serve.count < r->ticks);
    assert_true(r->most_contacts > 5);
    assert_true(r->crossing.max >= 1000000); /* an answer arrives one tick after the request at the earliest */
}

/* Inserts and withdraws. Contact nodes removed during the withdrawal do not count as late. */
static void crossings_during_retraction_are_ignored(void **unused) {
    (void)unused;
    scale_timing in = *measured(ASIDE, NULL, 0.05, WHOLE, 1e-3, "dense");
    const scale_timing *r = measured(ASIDE, motion_find("insert"), 0, 0, 1e-3, "dense");
    assert_int_equal(r->ticks, 3500);
    assert_in_range(r->crossings, in.crossings * 3 / 4, in.crossings * 3 / 2);
    check_counts(r);
    if (SANITIZED) return;
    assert_int_equal(r->late_crossings, 0);
    assert_true(r->contacts >= r->most_contacts);
}

/* The needle moves 20 mm in 20 us. No answer arrives in that time, so every tick after first touch is late. (It cannot go deeper: without measured
   compliance, the needle buckles at about 30 mm, and a tick without an equilibrium cannot use an answer.) At 2 m/s some answers arrive. */
static void worker_slower_than_the_needle_is_late(void **unused) {
    (void)unused;
    const double speed = 1000.0, dt = 2e-8;
    scale_timing none = *measured(ASIDE, NULL, speed, 0.02, dt, "sparse");
    int before = (int)(ABOVE / (speed * dt) + 0.5); /* tick of first touch (give or take a tick, due to rounding) */
    check_counts(&none);
    assert_int_equal(none.unanswered, none.contacts);
    assert_in_range(none.late_ticks, none.ticks - before - 1, none.ticks - before + 1);
    const scale_timing *some = measured(ASIDE, NULL, 2.0, WHOLE, 1e-5, "sparse");
    check_counts(some);
    if (SANITIZED) return;
    assert_true(some->contacts > 0 && some->crossing.max > 20000); /* more than two ticks late */
}

/* At 3 mm per tick, the tip crosses some elements within a single tick, and answers arrive two ticks after the request. */
static void late_contact_nodes_are_counted(void **unused) {
    (void)unused;
    enum { ATTEMPTS = 10 }; /* the motion takes 50 ms, during which a busy machine may not run the worker at all, so that no contact becomes active */
    const scale_timing *r;
    int attempt = 0;
    do {
        r = measured(ASIDE, NULL, 3.0, WHOLE, 1e-3, "dense");
        check_counts(r);
    } while (!SANITIZED && r->activation.max == 0 && ++attempt < ATTEMPTS);
    if (SANITIZED) return;
    print_message("%d of %d late, by %.1f ms at most\n", r->late_crossings, r->contacts, 1e-6 * (double)r->activation.max);
    assert_in_range(r->late_crossings, 1, r->contacts);
    /* the worker may be measuring a line at that moment and finish in the middle of a tick */
    assert_in_range(r->activation.max, 900000, 3100000 + r->patch.max);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(crossings_are_counted_and_answered),
        cmocka_unit_test(crossings_during_retraction_are_ignored),
        cmocka_unit_test(worker_slower_than_the_needle_is_late),
        cmocka_unit_test(late_contact_nodes_are_counted),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
