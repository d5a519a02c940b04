/* Tests how work is divided between ticks and worker, with a mesh update that fails on demand (the linker wraps the real function). */
#include "api/api.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <cmocka.h>

#include "host.h"

static bool fails;
static int served;

trocar_status __real_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);
trocar_status __wrap_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);
trocar_status __wrap_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why) {
    served++;
    if (!fails) return __real_remesher_serve(r, request, snapshot, why);
    snapshot->serial = request->serial; /* claims to answer the request, but with NaN compliances */
    memset(snapshot->compliance, 0xff, sizeof snapshot->compliance);
    snprintf(why->text, sizeof why->text, "no good");
    return TROCAR_NUMERIC;
}

static trocar_pose pose_at(int tick) { return (trocar_pose){{0.005, 0.003, -0.201 + 50e-6 * tick}, {1, 0, 0, 0}}; }

static void tick_on(host *h, int tick) {
    trocar_pose base = pose_at(tick);
    assert_int_equal(trocar_sim_tick(h->sim, 0, &base, 1e-3, &h->output), TROCAR_OK);
}

static host inserted(int ticks) {
    host h = host_open(MESHES "/figure8.yaml");
    trocar_pose start = pose_at(0);
    assert_int_equal(trocar_sim_reset(h.sim, 0, &start, NULL), TROCAR_OK);
    fails = false;
    for (int t = 0; t < ticks; t++) {
        tick_on(&h, t);
        assert_int_equal(trocar_sim_work(h.sim, NULL, NULL), TROCAR_OK);
    }
    return h;
}

static void only_the_newest_request_is_served(void **unused) {
    (void)unused;
    host h = inserted(300);
    uint64_t before = h.sim->needles[0].link.posted;
    for (int t = 300; t < 500; t++) tick_on(&h, t);
    assert_true(h.sim->needles[0].link.posted > before + 2);
    served = 0;
    trocar_work done;
    for (int i = 0; i < 3; i++) {
        assert_int_equal(trocar_sim_work(h.sim, &done, NULL), TROCAR_OK);
        assert_int_equal(done.answered, i == 0);
    }
    assert_int_equal(served, 1);
    tick_on(&h, 500);
    assert_true(h.sim->needles[0].link.answered + 1 >= h.sim->needles[0].link.posted); /* everything has been answered except this tick's own request */
    host_close(&h);
}

static void a_failure_leaves_the_last_answer_in_force(void **unused) {
    (void)unused;
    host h = inserted(300);
    uint64_t answered = h.sim->needles[0].link.answered;
    trocar_work done;
    trocar_error why;
    int failures = 0;
    fails = true;
    for (int t = 300; t < 400; t++) {
        tick_on(&h, t);
        failures += trocar_sim_work(h.sim, &done, &why) == TROCAR_NUMERIC;
        assert_int_equal(done.answered, 0);
    }
    assert_true(failures > 0 && isfinite(h.output.force[2]) && h.output.force[2] < 0.0);
    assert_string_equal(why.text, "no good");
    assert_true(h.sim->needles[0].link.answered <= answered + 1 && h.sim->needles[0].link.answered < h.sim->needles[0].link.posted);
    fails = false; /* recovers */
    for (int t = 400; t < 500; t++) {
        tick_on(&h, t);
        assert_int_equal(trocar_sim_work(h.sim, &done, &why), TROCAR_OK);
    }
    assert_true(h.sim->needles[0].link.answered + 1 >= h.sim->needles[0].link.posted && h.output.contacts > 2);
    host_close(&h);
}

/* If the state contains a NaN, the status says so, and the insertion restarts at the base's position. */
static void a_tick_that_is_not_finite_starts_over(void **unused) {
    (void)unused;
    host h = inserted(300);
    h.sim->needles[0].state.tip.place.depth = NAN;
    trocar_pose base = pose_at(300);
    assert_int_equal(trocar_sim_tick(h.sim, 0, &base, 1e-3, &h.output), TROCAR_NUMERIC);
    assert_true(h.output.events == TROCAR_EVENT_UNSTABLE && h.output.force[2] == 0.0 && h.output.membrane == -1);
    for (int t = 300; t < 400; t++) {
        base = pose_at(t);
        assert_int_equal(trocar_sim_step(h.sim, 0, &base, 1e-3, &h.output, NULL), TROCAR_OK);
    }
    assert_true(h.output.force[2] < 0.0);
    h.sim->needles[0].state.tip.place.depth = NAN;
    assert_int_equal(trocar_sim_step(h.sim, 0, &base, 1e-3, &h.output, NULL), TROCAR_OK);
    assert_true(h.output.events == TROCAR_EVENT_UNSTABLE && h.output.force[2] == 0.0);
    host_close(&h);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(only_the_newest_request_is_served),
        cmocka_unit_test(a_failure_leaves_the_last_answer_in_force),
        cmocka_unit_test(a_tick_that_is_not_finite_starts_over),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
