/* A log played again shows what trocar-replay computes. */
#include "playback.h"

#include <string.h>

#include "poselog.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "check.h"

static void the_golden_trace_comes_out_as_it_is_kept(void **unused) {
    (void)unused;
    scene s;
    report why;
    timeline t;
    assert_int_equal(scene_load(MESHES "/figure8.yaml", &s, &why), TROCAR_OK);
    assert_int_equal(timeline_create(&t, false, &why), TROCAR_OK);
    assert_int_equal(playback_run(&s, SOURCE_DIR "/tests/traces/figure8.log", &t, &why), TROCAR_OK);

    wrench_log golden;
    assert_int_equal(wrench_log_read(SOURCE_DIR "/tests/traces/figure8-golden.log", &golden, &why), TROCAR_OK);
    int64_t start = golden.wrenches[0].utime;
    int compared = 0, punctures = 0;
    for (int64_t i = 0; i < t.sample_end; i++) punctures += t.samples[i].membrane >= 0;
    for (int g = 0, i = 0; g < golden.count; g++) {
        double time = 1e-6 * (double)(golden.wrenches[g].utime - start);
        while (i < t.sample_end && t.samples[i].time < time - 1e-6) i++;
        if (i == t.sample_end || fabs(t.samples[i].time - time) > 1e-6) continue;
        for (int a = 0; a < 3; a++) assert_close(t.samples[i].force[a], golden.wrenches[g].force[a], 0.02); /* 1 % of the peak */
        compared++;
    }
    wrench_log_free(&golden);
    assert_true(compared > 50);
    assert_int_equal(punctures, 2);
    assert_true(t.picture_end >= (int64_t)(PLAYBACK_HZ * t.now));
    timeline_free(&t);
}

static void a_missing_log_is_said(void **unused) {
    (void)unused;
    scene s;
    report why;
    timeline t;
    assert_int_equal(scene_load(MESHES "/figure8.yaml", &s, &why), TROCAR_OK);
    assert_int_equal(timeline_create(&t, false, &why), TROCAR_OK);
    assert_int_equal(playback_run(&s, "none.log", &t, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "none.log"));
    timeline_free(&t);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_golden_trace_comes_out_as_it_is_kept),
        cmocka_unit_test(a_missing_log_is_said),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
