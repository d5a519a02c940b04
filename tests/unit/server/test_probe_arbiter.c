/* Tests which probe poses the arbiter accepts and refuses, depending on their bytes and session, and follows an accepted pose through the IO and haptic
   threads until it shows up in a message. */
#include <string.h>

#include "common/timing.h"
#include "haptic.h"
#include "intake/probe_arbiter.h"
#include "io.h"
#include "scene/device.h"
#include "trocar_probe_pose_t.h"
#include "trocar_probe_wrench_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static const int64_t SECOND = 1000000000;
static char message[200];
static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

static trocar_probe_pose_t pose_message(int64_t session, int64_t seq, double x) {
    return (trocar_probe_pose_t){.session = session, .seq = seq, .position = {x, 0, 0}, .orientation = {1, 0, 0, 0}};
}

static bool take(probe_arbiter *in, const trocar_probe_pose_t *m, int64_t now) {
    unsigned char data[256];
    int size = trocar_probe_pose_t_encode(data, 0, sizeof data, m);
    return probe_arbiter_pose(in, data, (size_t)size, now, message, sizeof message);
}

static bool take_pose(probe_arbiter *in, int64_t session, int64_t seq, int64_t now) {
    trocar_probe_pose_t m = pose_message(session, seq, 0.001 * (double)seq);
    return take(in, &m, now);
}

static void one_owner_until_it_is_silent(void **unused) {
    (void)unused;
    probe_arbiter in;
    probe_arbiter_init(&in);
    assert_true(take_pose(&in, 5, 1, SECOND));
    assert_false(take_pose(&in, 6, 1, SECOND + 1));
    assert_non_null(strstr(message, "another session holds the probe"));
    assert_false(take_pose(&in, 5, 1, SECOND + 2)); /* repeated */
    assert_true(take_pose(&in, 5, 2, SECOND + 3));
    assert_false(take_pose(&in, 0, 3, 9 * SECOND));
    assert_false(take_pose(&in, 6, 1, 3 * SECOND));
    assert_true(take_pose(&in, 6, 1, 3 * SECOND + 4));
    assert_int_equal(in.newest.session, 6);
    assert_true(in.newest.base.position.x == 0.001);
    assert_int_equal(in.accepted, 3);
    assert_int_equal(in.refused, 4);
}

static void no_sequence_number_locks_the_owner_out(void **unused) {
    (void)unused;
    probe_arbiter in;
    probe_arbiter_init(&in);
    assert_true(take_pose(&in, 5, 1, SECOND));
    trocar_probe_pose_t forged = pose_message(5, INT64_MAX, 0);
    assert_false(take(&in, &forged, SECOND));
    for (int64_t seq = 2; seq < 10; seq++) assert_true(take_pose(&in, 5, seq, SECOND));
    for (int64_t seq = 1; seq < 10; seq++) assert_int_equal(take_pose(&in, 5, seq, SECOND), seq >= SEQUENCE_RUN); /* a sender that restarts its numbering */
}

static void invalid_messages_are_counted(void **unused) {
    (void)unused;
    probe_arbiter in;
    unsigned char data[256];
    probe_arbiter_init(&in);
    trocar_probe_pose_t good = pose_message(5, 1, 0), bad = good;
    int size = trocar_probe_pose_t_encode(data, 0, sizeof data, &good);
    for (int k = 0; k <= (int)sizeof data; k++)
        if (k != size) assert_false(probe_arbiter_pose(&in, data, (size_t)k, 0, message, sizeof message));
    for (int bit = 0; bit < 64; bit++) { /* flips each bit of the fingerprint */
        data[bit / 8] ^= (unsigned char)(1 << bit % 8);
        assert_false(probe_arbiter_pose(&in, data, (size_t)size, 0, message, sizeof message));
        data[bit / 8] ^= (unsigned char)(1 << bit % 8);
    }
    bad.position[2] = NAN;
    assert_false(take(&in, &bad, 0));
    bad = good;
    bad.orientation[1] = 0.1;
    assert_false(take(&in, &bad, 0));
    assert_int_equal(in.refused, sizeof data + 64 + 2);
    assert_int_equal(in.newest.session, 0);
}

static trocar_probe_wrench_t last;
static int received;

static void on_wrench(const lcm_recv_buf_t *b, const char *channel, const trocar_probe_wrench_t *m, void *context) {
    (void)b, (void)channel, (void)context;
    last = *m;
    received++;
}

/* A message moves the probe, the simulation's worker presses it against the tissue, and another message reports the result. */
static void pressed_by_message(void **unused) {
    (void)unused;
    static exchange x;
    static haptic h;
    static io o;
    trocar_scene *scene;
    trocar_model *model;
    trocar_sim *sim;
    device_limits limits = device_defaults();
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    OK(trocar_scene_set(scene, "probe.surface", "skin", &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &sim, &why));
    OK(exchange_create(&x, model, &why));
    haptic_init(&h, sim, 1, &limits, 1000, 0, &x);
    OK(io_create(&o, "memq://", 1, &limits, false, -1, &x, &why));
    OK(io_open(&o));
    trocar_probe_wrench_t_subscription_t *s = trocar_probe_wrench_t_subscribe(o.lcm, "TROCAR_PROBE_WRENCH", on_wrench, NULL);
    for (int tick = 0; tick < 60; tick++) {
        const double half = sqrt(0.5); /* the probe lies along x, 3 mm below the skin at z = 0 */
        trocar_probe_pose_t m = {.session = 9, .seq = tick, .position = {-0.1, 0, 0.003 - 0.010}, .orientation = {half, 0, half, 0}};
        if (tick >= 20 && tick < 40) trocar_probe_pose_t_publish(o.lcm, "TROCAR_PROBE", &m);
        OK(io_round(&o));
        haptic_tick(&h, &(loop_wake){.tick = tick, .now = monotonic_ns(), .elapsed = 1e-3});
        for (trocar_work work = {.more = 1}; work.more;) OK(trocar_sim_work(sim, &work, &why));
        if (tick < 20) assert_int_equal(received, 0);
    }
    OK(io_round(&o));
    OK(io_round(&o));
    assert_in_range(received, 1, 4); /* only a few, because the probe did not move */
    assert_int_equal(last.session, 9);
    assert_true(last.pose_seq >= 30 && last.contacts > 2 && last.force[2] < -0.5);
    assert_true(last.position[2] == 0.003 - 0.010);
    assert_true(h.probe.contacts == last.contacts);
    trocar_probe_wrench_t_unsubscribe(o.lcm, s);
    io_close(&o);
    io_free(&o);
    exchange_free(&x);
    trocar_sim_free(sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(one_owner_until_it_is_silent),
        cmocka_unit_test(no_sequence_number_locks_the_owner_out),
        cmocka_unit_test(invalid_messages_are_counted),
        cmocka_unit_test(pressed_by_message),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
