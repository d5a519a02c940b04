/* Compares the shaft's tributary lengths and its friction in two regions with sums worked out by hand. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "insertion/state/shaft.h"

#include <cmocka.h>

#include "check.h"

static const region_material MATERIALS[2] = {
    {.youngs_modulus = 9e3, .poisson_ratio = 0.5 - 1e-3, .friction_static = 6.0, .friction_kinetic = 4.0, .friction_viscous = 30.0},
    {.youngs_modulus = 60e3, .poisson_ratio = 0.3, .friction_static = 20.0, .friction_kinetic = 10.0, .friction_viscous = 50.0},
};
static int region_of_tet[2] = {0, 1};
static mesh two_regions = {.tet_count = 2, .region = region_of_tet};
static const insertion_model MODEL = {.mesh = &two_regions, .materials = MATERIALS, .settings = {.weakening_distance = 2e-3}};

static void activate(insertion_state *s, int count) {
    s->refined.count = count;
    for (int i = 0; i < count; i++) {
        s->refined.order[i] = i;
        s->contacts[i].status = CONTACT_ACTIVE;
    }
}

/* Returns a state with contacts at 4, 10 and 11 mm and the tip at 20 mm. The second region begins at 9 mm. */
static insertion_state inserted(void) {
    insertion_state state = {.stratum_count = 2, .strata = {{0.0, 0}, {9e-3, 1}}};
    activate(&state, 3);
    state.contacts[0].depth = 4e-3;
    state.contacts[1].depth = 10e-3;
    state.contacts[2].depth = 11e-3;
    state.tip = (needle_tip){.place = {.phase = TIP_INSIDE, .depth = 20e-3}};
    return state;
}

static void assert_share(const insertion_state *s, int index, bool tip, double from, double to) {
    shaft_share share = shaft_share_of(s, index, tip);
    assert_close(share.from, from, 1e-15);
    assert_close(share.to, to, 1e-15);
}

static void tributary_lengths_meet_half_way_and_reach_the_end(void **unused) {
    (void)unused;
    insertion_state s = inserted();
    s.stratum_count = 1;
    assert_share(&s, 0, true, 0.0, 7e-3);
    assert_share(&s, 1, true, 7e-3, 10.5e-3);
    assert_share(&s, 2, true, 10.5e-3, 15.5e-3);
    assert_share(&s, 3, true, 15.5e-3, 20e-3);
    assert_share(&s, 1, false, 7e-3, 10.5e-3);
    assert_share(&s, 2, false, 10.5e-3, 20e-3);
    activate(&s, 0);
    assert_share(&s, 0, true, 0.0, 20e-3);
    s.tip.place.depth = 0.0; /* on the skin */
    assert_share(&s, 0, true, 0.0, 1e-6);
}

/* When the tip enters the next region, the end of the last tributary length moves from the midpoint to the boundary between the regions, no faster than the
   tip. No contact must stand for a part of the shaft in the other region. */
static void tributary_lengths_end_at_region_boundaries(void **unused) {
    (void)unused;
    insertion_state s = inserted();
    activate(&s, 1); /* a contact at 4 mm; the next region begins at 9 mm */
    double last = 6.5e-3;
    for (double tip = 9e-3; tip < 20e-3; tip += 1e-6) {
        s.tip.place.depth = tip;
        double border = shaft_share_of(&s, 0, true).to;
        assert_close(border, last, 1.6e-6);
        assert_close(border, fmin(0.5 * (4e-3 + tip) + tip - 9e-3, 9e-3), 1e-12);
        last = border;
    }
    s = inserted();
    assert_share(&s, 0, true, 0.0, 8e-3); /* the next contact is 1 mm beyond the region boundary */
    s.strata[1].depth = 6e-3;
    assert_share(&s, 0, true, 0.0, 6e-3);
    assert_share(&s, 1, true, 6e-3, 10.5e-3);
}

static void friction_is_that_of_each_region(void **unused) {
    (void)unused;
    insertion_state s = inserted();
    shaft_resistance both = shaft_resistance_of(&MODEL, &s, (shaft_share){7e-3, 10.5e-3});
    shaft_resistance first = shaft_resistance_of(&MODEL, &s, (shaft_share){1e-3, 2e-3});
    assert_close(shaft_friction_limit(&MODEL, &both, 0.0), 2e-3 * 6.0 + 1.5e-3 * 20.0, 1e-15);
    assert_close(both.viscous, 2e-3 * 30.0 + 1.5e-3 * 50.0, 1e-15);
    assert_close(shaft_friction_limit(&MODEL, &both, 1.0), 2e-3 * 4.0 + 1.5e-3 * 10.0, 1e-15);
    assert_close(shaft_friction_limit(&MODEL, &first, 2e-3), 1e-3 * (4.0 + 2.0 / M_E), 1e-15);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tributary_lengths_meet_half_way_and_reach_the_end),
        cmocka_unit_test(tributary_lengths_end_at_region_boundaries),
        cmocka_unit_test(friction_is_that_of_each_region),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
