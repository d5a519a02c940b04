/* Tests old tracks. At a track's end, the uncut tissue resists immediately. Close to an earlier puncture, a membrane counts as partly torn. Tissue springs
   back into a track no faster than into intact tissue. */
#include "lockstep.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static const double SPEED = 0.02, DT = 1e-3; /* m/s, s */

/* Returns by how much the force rises per metre (N/m) when the hand advances and the tip stays put. */
static double stiffness_of(lockstep *l) {
    insertion_state before = l->state;
    pose base = l->base;
    tick_output wrench = l->wrench;
    double cutting[MESH_MAX_GROUPS];
    for (int i = 0; i < MESH_MAX_GROUPS; i++) cutting[i] = l->parts.materials[i].cutting_force, l->parts.materials[i].cutting_force = 1e3;
    lockstep_move(l, v3(0, 0, 6e-5), 3 * DT, DT); /* it stops */
    double force = v3_norm(l->wrench.force);
    lockstep_move(l, v3(0, 0, 1e-4), 5 * DT, DT);
    force = v3_norm(l->wrench.force) - force;
    for (int i = 0; i < MESH_MAX_GROUPS; i++) l->parts.materials[i].cutting_force = cutting[i];
    l->state = before;
    l->base = base;
    l->wrench = wrench;
    return force / 1e-4;
}

/* A needle cuts at constant speed and then meets a short piece of track. The tip springs forward to the end of that piece and no further. The force
   therefore drops by the elastic force over that length, and by the viscous force, which is zero while the tip rests at the end. */
static void a_short_track_gives_back_its_length(void **state) {
    (void)state;
    static const double LENGTHS[] = {1.5e-5, 1e-4, 3e-4}; /* m; without resistance beyond the track, the tip would spring forward by more than this */
    for (int i = 0; i < 3; i++) {
        simulation_config config = lockstep_config();
        lockstep *l = lockstep_create(&config, lockstep_start());
        lockstep_move(l, v3(0, 0, 0.031), 0.031 / SPEED, DT);
        const needle_tip *tip = &l->state.tip;
        double back = stiffness_of(l) * LENGTHS[i] + l->parts.materials[l->parts.mesh.region[tip->place.tet]].cutting_viscosity * SPEED;
        vec3 end = v3_axpy(LENGTHS[i], tip->place.direction, tip->place.nominal);
        l->state.tracks.count = l->state.tracks.point_count = 0;
        tracks_cut(&l->state.tracks, (track_point){.at = tip->place.nominal, .tet = tip->place.tet}, (track_point){.at = end, .tet = tip->place.tet});
        double steady = v3_norm(l->wrench.force), least = steady, most = steady, last = steady, step = 0.0;
        for (int k = 0; k < 20; k++) {
            lockstep_move(l, v3(0, 0, SPEED * DT), DT, DT);
            double force = v3_norm(l->wrench.force);
            least = fmin(least, force);
            most = fmax(most, force);
            step = fmax(step, fabs(force - last));
            last = force;
        }
        print_message("%.0f um: %.4f N before, from %.4f to %.4f N, by %.4f N in a tick; %.4f N given back\n", 1e6 * LENGTHS[i], steady, least, most, step, back);
        assert_true(most - steady < 0.005 && steady - least < back);
        assert_true(step < 0.05); /* noticeable */
        lockstep_free(l);
    }
}

/* A tip pressed against the end of its track, but not hard enough to cut, stays there. After being drawn back, it finds the track again. */
static void a_tip_rests_at_the_end(void **state) {
    (void)state;
    simulation_config config = lockstep_config();
    lockstep *l = lockstep_create(&config, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.031), 0.031 / SPEED, DT);
    for (int k = 0; k < 50; k++) lockstep_tick(l, l->base, DT); /* the hand rests, but the tip goes on cutting for a moment */
    double end = l->state.tip.place.depth;
    for (int k = 0; k < 500; k++) { /* after the hand has reversed, too, the tip goes on cutting for a moment */
        lockstep_move(l, v3(0, 0, -SPEED * DT), DT, DT);
        end = fmax(end, l->state.tip.place.depth);
    }
    do lockstep_move(l, v3(0, 0, SPEED * DT), DT, DT);
    while (l->state.tip.track.openness == 1.0 && l->wrench.depth <= end);
    double reached = l->wrench.depth;
    print_message("end at %.4f mm, reached %.4f mm\n", 1e3 * end, 1e3 * reached);
    assert_true(reached <= end && reached > end - 2.0 * SPEED * DT);
    for (int k = 0; k < 20; k++) {
        lockstep_tick(l, l->base, DT);
        assert_true(l->wrench.depth == reached && l->state.tip.track.openness == 0.0);
        assert_int_equal(l->wrench.passes, 1);
    }
    lockstep_move(l, v3(0, 0, -0.01), 0.01 / SPEED, DT);
    assert_true(l->state.tip.track.openness == 1.0);
    lockstep_free(l);
}

/* The closer a membrane is hit to an earlier puncture, the lower its puncture force: from that of an intact membrane at 1.5 times the reach down to zero at
   the reach. */
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
            most = fmax(most, l->state.tip.solved.end_force);
        }
        print_message("%.2f times the reach from a puncture: %.3f N\n", TIMES[k], most);
        assert_true(fabs(most - LEFT[k] * config.membranes[0].puncture_force) < 0.03);
        lockstep_free(l);
    }
}

/* Presses a needle against hard tissue, holds it there, and then puts a piece of track of this length (m; 0 for none) in front of it. */
static lockstep *pressed_before_a_track(double whole, double left, double length) {
    simulation_config config = lockstep_config();
    lockstep *l = lockstep_create(&config, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.031), 0.031 / SPEED, DT);
    for (int i = 0; i < MESH_MAX_GROUPS; i++) l->parts.materials[i].cutting_force = whole;
    lockstep_move(l, v3(0, 0, 0.003), 0.003 / SPEED, DT);
    for (int k = 0; k < 50; k++) lockstep_tick(l, l->base, DT);
    for (int i = 0; i < MESH_MAX_GROUPS; i++) l->parts.materials[i].cutting_force = left;
    const needle_tip *tip = &l->state.tip;
    l->state.tracks.count = l->state.tracks.point_count = 0;
    vec3 end = v3_axpy(length, l->run.workspace->path.cut_direction, tip->place.nominal);
    if (length > 0.0) tracks_cut(&l->state.tracks, (track_point){.at = tip->place.nominal, .tet = tip->place.tet}, (track_point){.at = end, .tet = tip->place.tet});
    return l;
}

/* Where nothing is cut, tissue springs back over a needle held in a track as fast as it does in tissue without cutting resistance. A needle that advances in
   the track meets no viscosity. */
static void tissue_springs_back_into_a_track(void **state) {
    (void)state;
    lockstep *track = pressed_before_a_track(2.0, 2.0, 0.05), *soft = pressed_before_a_track(2.0, 0.0, 0.0);
    double before = v3_norm(track->wrench.force), largest = 0.0;
    for (int k = 0; k < 60; k++) {
        double last = v3_norm(track->wrench.force);
        lockstep_tick(track, track->base, DT);
        lockstep_tick(soft, soft->base, DT);
        double f = v3_norm(track->wrench.force), g = v3_norm(soft->wrench.force);
        if (k > 1) largest = fmax(largest, last - f); /* in the first tick, the cutting resistance ends and the shaft follows */
        assert_true(track->state.tip.track.openness == 1.0);
        assert_true(fabs(f - g) < 1e-3 * before);
    }
    print_message("%.3f N before, %.3f N 60 ms after; largest fall in a tick after the first two %.3f N\n", before, v3_norm(track->wrench.force), largest);
    assert_true(v3_norm(track->wrench.force) < 0.7 * before && largest < 0.07 * before);
    double viscosity = track->parts.materials[track->parts.mesh.region[track->state.tip.place.tet]].cutting_viscosity, most = 0.0;
    for (int k = 0; k < 30; k++) {
        lockstep_move(track, v3(0, 0, 0.05 * DT), DT, DT);
        if (k >= 15) most = fmax(most, track->state.tip.solved.end_force);
    }
    print_message("at 50 mm/s in the track: %.4f N, in whole tissue viscosity alone is %.2f N\n", most, 0.05 * viscosity);
    assert_true(track->state.tip.track.openness == 1.0 && most < 0.1 * 0.05 * viscosity);
    lockstep_free(track);
    lockstep_free(soft);
}

/* A step in which tissue springs back, or in which the tip reaches the end of its track, is solved only once, so it takes no more passes than a step in
   intact tissue. */
static void nothing_is_solved_again(void **state) {
    (void)state;
    static const struct { double length; int hand; } CASES[] = {{0.0, 2}, {0.05, 0}, {0.05, 1}, {0.05, 2}, {0.01, 2}};
    for (int k = 0; k < 5; k++) {
        lockstep *l = pressed_before_a_track(2.0, 2.0, CASES[k].length);
        int passes = 0;
        for (int i = 0; i < 400; i++) {
            double turning_back[] = {0.04, 0.01, -0.02, 0.0}, stopping[] = {0.0, 0.03};
            double speed = CASES[k].hand == 0 ? 0.0 : CASES[k].hand == 1 ? turning_back[i / 10 % 4] : stopping[i / 5 % 2];
            lockstep_move(l, v3(0, 0, speed * DT), DT, DT);
            passes += l->wrench.passes;
            assert_true(l->wrench.passes <= 3);
        }
        print_message("track of %.0f mm: %.2f passes a tick\n", 1e3 * CASES[k].length, passes / 400.0);
        lockstep_free(l);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_short_track_gives_back_its_length),
        cmocka_unit_test(a_tip_rests_at_the_end),
        cmocka_unit_test(a_membrane_is_torn_beside_a_puncture),
        cmocka_unit_test(tissue_springs_back_into_a_track),
        cmocka_unit_test(nothing_is_solved_again),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
