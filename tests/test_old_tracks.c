/* Old tracks near their ends, near the surface and side by side: nothing jumps. */
#include "lockstep.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static const double SPEED = 0.02, DT = 1e-3; /* m/s, s */

/* A needle cuts at constant speed, then meets a short piece of track. */
static void a_short_track_is_passed_without_a_jump(void **state) {
    (void)state;
    static const double LENGTHS[] = {1.5e-5, 1e-4, 3e-4}; /* m; the tip would spring forward by more, were nothing behind it */
    for (int i = 0; i < 3; i++) {
        simulation_config config = lockstep_config();
        lockstep *l = lockstep_create(&config, lockstep_start());
        lockstep_move(l, v3(0, 0, 0.031), 0.031 / SPEED, DT);
        const needle_tip *tip = &l->state.tip;
        vec3 end = v3_axpy(LENGTHS[i], tip->direction, tip->nominal);
        l->state.tracks.count = l->state.tracks.point_count = 0;
        tracks_cut(&l->state.tracks, (track_point){.at = tip->nominal, .tet = tip->tet}, (track_point){.at = end, .tet = tip->tet});
        double steady = v3_norm(l->wrench.force), least = steady, most = steady;
        for (int k = 0; k < 20; k++) {
            lockstep_move(l, v3(0, 0, SPEED * DT), DT, DT);
            least = fmin(least, v3_norm(l->wrench.force));
            most = fmax(most, v3_norm(l->wrench.force));
        }
        print_message("%.0f um: %.4f N before, from %.4f to %.4f N\n", 1e6 * LENGTHS[i], steady, least, most);
        assert_true(most - least < 0.01);
        lockstep_free(l);
    }
}

/* Pressed on, but not so hard that it cuts, a tip at the end of its track stays there; drawn back, it finds the track again. */
static void a_tip_rests_at_the_end(void **state) {
    (void)state;
    simulation_config config = lockstep_config();
    lockstep *l = lockstep_create(&config, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.031), 0.031 / SPEED, DT);
    for (int k = 0; k < 50; k++) lockstep_tick(l, l->base, DT); /* it cuts on for a moment */
    double end = l->state.tip.depth;
    lockstep_move(l, v3(0, 0, -0.01), 0.01 / SPEED, DT);
    while (l->state.tip.ended == 0.0 && l->wrench.depth <= end) lockstep_move(l, v3(0, 0, SPEED * DT), DT, DT);
    double reached = l->wrench.depth;
    print_message("end at %.4f mm, reached %.4f mm\n", 1e3 * end, 1e3 * reached);
    assert_true(reached <= end && reached > end - 2.0 * SPEED * DT);
    for (int k = 0; k < 20; k++) {
        lockstep_tick(l, l->base, DT);
        assert_true(l->wrench.depth == reached && l->state.tip.open == 0.0);
        assert_int_equal(l->wrench.passes, 1);
    }
    lockstep_move(l, v3(0, 0, -0.01), 0.01 / SPEED, DT);
    assert_true(l->state.tip.ended == 0.0 && l->state.tip.open == 1.0);
    lockstep_free(l);
}

/* ---- near the surface ----------------------------------------------------------------------------------------------------- */

/* Largest change of the base force in a tick on this way, as a part of max(7 %, 0.05 N), but at a puncture. */
static double largest_change(lockstep *l, vec3 way, double seconds) {
    pose from = l->base;
    double largest = 0.0;
    int ticks = (int)(seconds / DT + 0.5), since = 2;
    for (int i = 1; i <= ticks; i++) {
        vec3 before = l->wrench.force;
        lockstep_tick(l, (pose){v3_axpy((double)i / ticks, way, from.position), from.orientation}, DT);
        since = l->wrench.events & EVENT_PUNCTURED ? 0 : since + 1;
        if (since >= 2) largest = fmax(largest, v3_norm(v3_sub(l->wrench.force, before)) / fmax(0.05, 0.07 * v3_norm(before)));
    }
    return largest;
}

/* The direction of cutting follows the deformed tissue: it does so evenly from the surface on, and not at once with the first contact. */
static void the_first_contact_turns_no_tip(void **state) {
    (void)state;
    simulation_config config = lockstep_config();
    vec3 axis = q_rotate(q_exp(v3(0, 0.3, 0)), v3(0, 0, 1));
    lockstep *l = lockstep_create(&config, (pose){v3_axpy(-0.201, axis, v3(0.005, 0.003, 0)), q_exp(v3(0, 0.3, 0))});
    while (l->state.tip.depth == 0.0) lockstep_move(l, v3_scale(SPEED * DT, axis), DT, DT);
    vec3 aim = l->simulation.workspace->aim;
    bool added = false;
    double turned = 0.0;
    for (int k = 0; k < 300 && !added; k++) {
        lockstep_move(l, v3_scale(SPEED * DT, axis), DT, DT);
        turned = v3_norm(v3_sub(l->simulation.workspace->aim, aim));
        aim = l->simulation.workspace->aim;
        added = contact_is_active(&l->state, 0);
    }
    for (int k = 0; k < 2; k++) { /* the gradient is that of the tick's start */
        lockstep_move(l, v3_scale(SPEED * DT, axis), DT, DT);
        turned = fmax(turned, v3_norm(v3_sub(l->simulation.workspace->aim, aim)));
        aim = l->simulation.workspace->aim;
    }
    print_message("first contact at %.2f mm: the direction of cutting turns by %.2f degrees in a tick\n", 1e3 * l->state.tip.depth, 57.3 * turned);
    assert_true(added);
    assert_true(turned < 0.01);
    lockstep_free(l);
}

/* Loaded sideways and drawn out of its track, the needle is let go evenly: its contacts as well as its tip, which does not go in and out in turns. */
static void a_bent_needle_is_let_go_evenly(void **state) {
    (void)state;
    static const double SIDEWAYS[] = {2e-3, 5e-3, 10e-3}; /* m, of the base */
    for (int k = 0; k < 3; k++) {
        simulation_config config = lockstep_config();
        lockstep *l = lockstep_create(&config, lockstep_start());
        lockstep_move(l, v3(0, 0, 0.011), 0.011 / SPEED, DT);
        lockstep_move(l, v3(SIDEWAYS[k], 0, 0), 0.5, DT);
        double change = 0.0;
        int turns = 0;
        friction_state last = STICK;
        while (l->state.tip.phase == TIP_INSIDE && l->base.position.z > -0.21) {
            change = fmax(change, largest_change(l, v3(0, 0, -0.25 * SPEED * DT), DT));
            turns += l->state.tip.friction == SLIP_FORWARD && last == SLIP_BACKWARD;
            last = l->state.tip.friction;
        }
        print_message("%.0f mm sideways: largest change %.3f of what is noticed, %d times forward\n", 1e3 * SIDEWAYS[k], change, turns);
        assert_int_equal(l->state.tip.phase, TIP_FREE);
        assert_true(change < 0.3);
        assert_int_equal(turns, 0);
        lockstep_free(l);
    }
}

/* A membrane beside a puncture gives way the sooner the closer it is: the force falls from that of the whole membrane at 1.5 times the
   reach to none at the reach. */
static void a_membrane_is_torn_beside_a_puncture(void **state) {
    (void)state;
    static const double TIMES[] = {0.95, 1.1, 1.25, 1.4, 1.6}, LEFT[] = {0.0, 0.2, 0.5, 0.8, 1.0};
    for (int k = 0; k < 5; k++) {
        simulation_config config = lockstep_config();
        config.regions[0].material.cutting_force = config.regions[1].material.cutting_force = 0.02;
        lockstep *l = lockstep_create(&config, lockstep_start());
        double most = 0.0, reach = config.insertion.track_reach * config.needle.outer_diameter;
        vec3 entry = v3_axpy(0.201, v3(0, 0, 1), l->base.position);
        tracks_puncture(&l->state.tracks, (track_point){.at = v3_add(entry, v3(TIMES[k] * reach, 0, 0))}, 0);
        for (int i = 0; i < 1000 && !(l->wrench.events & EVENT_PUNCTURED) && l->wrench.depth == 0.0; i++) {
            lockstep_move(l, v3(0, 0, SPEED * DT), DT, DT);
            most = fmax(most, l->state.tip.end_force);
        }
        print_message("%.2f times the reach from a puncture: %.3f N\n", TIMES[k], most);
        assert_true(fabs(most - LEFT[k] * config.membranes[0].puncture_force) < 0.03);
        lockstep_free(l);
    }
}

/* ---- side by side --------------------------------------------------------------------------------------------------------- */

/* A short track, closer to the tip, ends where a long one leads on: the tip goes on as if it was not there. */
static void a_short_track_hides_no_long_one(void **state) {
    (void)state;
    double most[2];
    for (int both = 0; both < 2; both++) {
        simulation_config config = lockstep_config();
        lockstep *l = lockstep_create(&config, lockstep_start());
        lockstep_move(l, v3(0, 0, 0.021), 0.021 / SPEED, DT);
        lockstep_move(l, v3(0, 0, -0.005), 0.005 / SPEED, DT);
        const needle_tip *tip = &l->state.tip;
        vec3 beside = v3_axpy(0.5e-3, v3(1, 0, 0), tip->nominal), start = v3_axpy(0.2e-3, tip->direction, tip->nominal);
        l->state.tracks.count = l->state.tracks.point_count = 0;
        tracks_cut(&l->state.tracks, (track_point){.at = beside, .tet = tip->tet}, (track_point){.at = v3_axpy(20e-3, tip->direction, beside), .tet = tip->tet});
        if (both) tracks_cut(&l->state.tracks, (track_point){.at = tip->nominal, .tet = tip->tet}, (track_point){.at = v3_axpy(0.3e-3, tip->direction, start), .tet = tip->tet});
        most[both] = 0.0;
        for (int k = 0; k < 150; k++) {
            lockstep_move(l, v3(0, 0, SPEED * DT), DT, DT);
            most[both] = fmax(most[both], tip->end_force);
        }
        lockstep_free(l);
    }
    print_message("tip's force along a track: at most %.4f N, with a short one beside it %.4f N\n", most[0], most[1]);
    assert_true(most[1] < most[0] + 0.02);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_short_track_is_passed_without_a_jump),
        cmocka_unit_test(a_tip_rests_at_the_end),
        cmocka_unit_test(the_first_contact_turns_no_tip),
        cmocka_unit_test(a_bent_needle_is_let_go_evenly),
        cmocka_unit_test(a_membrane_is_torn_beside_a_puncture),
        cmocka_unit_test(a_short_track_hides_no_long_one),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
