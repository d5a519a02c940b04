/* Tests that a recorded track's direction varies as smoothly as the path that was cut. */
#include "insertion/state/track_list.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <cmocka.h>

static const double BEND = 0.15, LENGTH = 0.06, STEP = 5e-5; /* m; BEND: radius, like that of a bevelled needle's track; LENGTH: length of the track; STEP:
                                                                length cut per tick */

static vec3 point_at(double s) { return v3(BEND * (1.0 - cos(s / BEND)), 0, BEND * sin(s / BEND)); }
static vec3 direction_at(double s) { return v3(sin(s / BEND), 0, cos(s / BEND)); }

static double angle_between(vec3 a, vec3 b) { return atan2(v3_norm(v3_cross(a, b)), v3_dot(a, b)); }

/* Records an arc with unevenly spaced points. One membrane lies just behind a point, and two membranes lie at the same position. */
static track_list *cut_arc(void) {
    track_list *list = calloc(1, sizeof *list);
    int steps = (int)(LENGTH / STEP + 0.5);
    for (int i = 0; i < steps; i++) {
        assert_true(tracks_cut(list, (track_point){.at = point_at(i * STEP)}, (track_point){.at = point_at((i + 1) * STEP)}));
        if (i == 250 || i == 600) tracks_puncture(list, (track_point){.at = point_at((i + 1) * STEP)}, 1);
        if (i == 600) tracks_puncture(list, (track_point){.at = point_at((i + 1) * STEP)}, 2);
    }
    return list;
}

static void direction_turns_evenly(void **state) {
    (void)state;
    static const double BESIDE[] = {-1e-3, 0.0, 1e-3}; /* m, from the centre line of the arc */
    track_list *list = cut_arc();
    assert_int_equal(list->count, 1);
    for (int k = 0; k < 3; k++) {
        vec3 last = direction_at(0.0);
        double leap = 0.0, off = 0.0;
        for (double s = STEP; s < LENGTH; s += STEP) {
            vec3 across = v3(-direction_at(s).z, 0, direction_at(s).x);
            track_place place = tracks_closest(list, 0, v3_axpy(BESIDE[k], across, point_at(s)), 2e-3);
            assert_true(fabs(place.distance - fabs(BESIDE[k])) < 2e-5);
            if (s > STEP) leap = fmax(leap, angle_between(place.along, last));
            off = fmax(off, angle_between(place.along, direction_at(s)));
            last = place.along;
        }
        print_message("%.0f mm beside it: in a step of %.0f um it turns by %.3f degrees at most (the arc: %.3f); %.2f degrees off\n", 1e3 * BESIDE[k],
                      1e6 * STEP, 57.3 * leap, 57.3 * STEP / BEND, 57.3 * off);
        assert_true(leap < 2.0 * STEP / BEND);
        assert_true(off < 0.5 * TRACK_SPACING / BEND);
    }
    free(list);
}

/* A track that reverses has a direction even at its turning point. */
static void a_track_may_turn_back(void **state) {
    (void)state;
    track_list *list = calloc(1, sizeof *list);
    tracks_cut(list, (track_point){.at = v3(0, 0, 0)}, (track_point){.at = v3(0, 0, 12e-3)});
    tracks_cut(list, (track_point){.at = v3(0, 0, 12e-3)}, (track_point){.at = v3(0, 0, 0)});
    for (double z = 0.0; z < 13e-3; z += 1e-3) {
        track_place place = tracks_closest(list, 0, v3(0, 0, z), 2e-3);
        assert_true(fabs(v3_norm(place.along) - 1.0) < 1e-12);
    }
    free(list);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(direction_turns_evenly),
        cmocka_unit_test(a_track_may_turn_back),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
