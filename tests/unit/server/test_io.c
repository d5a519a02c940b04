/* Tests the IO thread's functions with a real LCM object (memq, no network): messages received end up in the shared buffers, and the buffers' contents are
   published. */
#include <poll.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "common/timing.h"
#include "io.h"
#include "scene/device.h"
#include "trocar_command_reply_t.h"
#include "trocar_command_t.h"
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

typedef struct {
    exchange exchange;
    io io;
    int shutdown;
    trocar_needle_wrench_t_subscription_t *subscription;
    int wrenches;
    trocar_needle_wrench_t last;
} fixture;

static void on_wrench(const lcm_recv_buf_t *b, const char *channel, const trocar_needle_wrench_t *m, void *context) {
    (void)b, (void)channel;
    fixture *f = context;
    f->wrenches++;
    f->last = *m;
}

static int open_fixture(void **state) {
    static fixture f;
    trocar_error why;
    device_limits limits = device_defaults();
    memset(&f, 0, sizeof f);
    f.shutdown = eventfd(0, EFD_NONBLOCK);
    assert_int_equal(exchange_create(&f.exchange, NULL, &why), TROCAR_OK);
    assert_int_equal(io_create(&f.io, "memq://", 1, &limits, false, f.shutdown, &f.exchange, &why), TROCAR_OK);
    assert_int_equal(io_open(&f.io), TROCAR_OK);
    f.subscription = trocar_needle_wrench_t_subscribe(f.io.lcm, "TROCAR_WRENCH", on_wrench, &f);
    *state = &f;
    return 0;
}

static int close_fixture(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t_unsubscribe(f->io.lcm, f->subscription);
    io_close(&f->io);
    io_free(&f->io);
    exchange_free(&f->exchange);
    close(f->shutdown);
    return 0;
}

static void send_pose(fixture *f, int64_t seq) {
    trocar_needle_pose_t m = {.session = 4, .seq = seq, .position = {0, 0, 0.001 * (double)seq}, .orientation = {1, 0, 0, 0}};
    trocar_needle_pose_t_publish(f->io.lcm, "TROCAR_POSE", &m);
}

static bool readable(int descriptor) {
    struct pollfd p = {.fd = descriptor, .events = POLLIN};
    return poll(&p, 1, 0) == 1;
}

static void one_round_reads_all_poses_and_keeps_the_newest(void **state) {
    fixture *f = *state;
    for (int64_t seq = 1; seq <= 5; seq++) send_pose(f, seq);
    assert_int_equal(io_round(&f->io), TROCAR_OK);
    bool fresh;
    const pose_sample *s = ((const newest_poses *)triple_buffer_read(&f->exchange.poses, &fresh))->needles;
    assert_true(fresh && s->held);
    assert_int_equal(s->seq, 5);
    assert_true(s->base.position.z == 0.005);
    const arbiter_record *in = triple_buffer_read(&f->exchange.intakes, NULL);
    assert_int_equal(in->needles[0].counts[POSE_ACCEPTED], 5);
}

static void invalid_messages_are_counted(void **state) {
    fixture *f = *state;
    unsigned char noise[1500];
    memset(noise, 0xa5, sizeof noise);
    send_pose(f, 1);
    for (unsigned size = 0; size < sizeof noise; size += 7) lcm_publish(f->io.lcm, "TROCAR_POSE", noise, size);
    lcm_publish(f->io.lcm, "TROCAR_COMMAND", noise, sizeof noise);
    io_round(&f->io);
    const arbiter_record *in = triple_buffer_read(&f->exchange.intakes, NULL);
    assert_int_equal(in->poses_malformed, (sizeof noise + 6) / 7);
    assert_int_equal(in->commands_refused, 1);
    assert_int_equal(((const newest_poses *)triple_buffer_read(&f->exchange.poses, NULL))->needles[0].seq, 1);
    assert_false(readable(f->shutdown));
}

static void all_wrenches_are_sent_in_order(void **state) {
    fixture *f = *state;
    for (int i = 0; i < 20; i++) {
        trocar_needle_wrench_t w = {.tick = i, .pose_seq = 100 + i, .force = {1, 2, 3.5}, .raw_torque = {0, 0, -1}, .flags = 5};
        assert_true(spsc_ring_push(&f->exchange.wrenches, &w));
    }
    io_round(&f->io); /* publishes */
    io_round(&f->io); /* memq delivers the message in the next round */
    assert_int_equal(f->wrenches, 20);
    assert_int_equal(f->last.tick, 19);
    assert_int_equal(f->last.pose_seq, 119);
    assert_int_equal(f->last.flags, 5);
    assert_true(f->last.force[2] == 3.5 && f->last.raw_torque[2] == -1);
}

static void a_release_reaches_the_loop(void **state) {
    fixture *f = *state;
    send_pose(f, 1);
    io_round(&f->io);
    trocar_command_t m = {.session = 4, .command = TROCAR_COMMAND_T_RELEASE};
    trocar_command_t_publish(f->io.lcm, "TROCAR_COMMAND", &m);
    io_round(&f->io);
    assert_false(((const newest_poses *)triple_buffer_read(&f->exchange.poses, NULL))->needles[0].held);
}

static void a_shutdown_wakes_the_server(void **state) {
    fixture *f = *state;
    trocar_command_t m = {.session = 9, .command = TROCAR_COMMAND_T_SHUTDOWN};
    trocar_command_t_publish(f->io.lcm, "TROCAR_COMMAND", &m);
    io_round(&f->io);
    assert_true(readable(f->shutdown));
}

typedef struct {
    int count;
    trocar_command_reply_t last;
    char message[256];
} replies;

static void on_reply(const lcm_recv_buf_t *b, const char *channel, const trocar_command_reply_t *m, void *context) {
    (void)b, (void)channel;
    replies *r = context;
    r->count++;
    r->last = *m;
    snprintf(r->message, sizeof r->message, "%s", m->message);
}

/* Publishes a command. memq delivers it in one round and the reply in the next. */
static void send_command(fixture *f, trocar_command_t m) {
    trocar_command_t_publish(f->io.lcm, "TROCAR_COMMAND", &m);
    io_round(&f->io);
    io_round(&f->io);
}

static void every_command_is_answered(void **state) {
    fixture *f = *state;
    replies r = {.count = 0};
    f->io.server = 77;
    trocar_command_reply_t_subscription_t *s = trocar_command_reply_t_subscribe(f->io.lcm, "TROCAR_REPLY", on_reply, &r);
    send_pose(f, 1);
    send_command(f, (trocar_command_t){.session = 5, .command = TROCAR_COMMAND_T_DROP_SEED, .seq = 11, .seeds = 1});
    assert_int_equal(r.count, 1);
    assert_true(r.last.status == TROCAR_COMMAND_REPLY_T_REFUSED && r.last.session == 5 && r.last.seq == 11 && r.last.server == 77);
    assert_non_null(strstr(r.message, "another session holds the needle"));
    send_command(f, (trocar_command_t){.session = 4, .command = TROCAR_COMMAND_T_UNDO, .seq = 12, .needle = 3});
    assert_int_equal(r.count, 2);
    assert_non_null(strstr(r.message, "refused for needle 3"));

    send_command(f, (trocar_command_t){.session = 4, .command = TROCAR_COMMAND_T_DROP_SEED, .seq = 13, .seeds = 4, .spacing = 0.01});
    assert_int_equal(r.count, 2); /* the third gets no reply until the haptic thread has answered it */
    needle_command answer;
    assert_true(spsc_ring_pop(&f->exchange.commands, &answer));
    assert_true(answer.asked.seeds == 4 && answer.asked.spacing == 0.01 && answer.asked.seq == 13);
    assert_false(spsc_ring_pop(&f->exchange.commands, &answer));
    spsc_ring_push(&f->exchange.replies, &answer);
    io_round(&f->io);
    io_round(&f->io);
    assert_true(r.count == 3 && r.last.status == TROCAR_COMMAND_REPLY_T_DONE && r.last.seq == 13 && r.last.command == TROCAR_COMMAND_T_DROP_SEED);
    assert_string_equal(r.message, "");

    answer.refused = true;
    strcpy(answer.why, "no seed");
    spsc_ring_push(&f->exchange.replies, &answer);
    io_round(&f->io);
    io_round(&f->io);
    assert_true(r.count == 4 && r.last.status == TROCAR_COMMAND_REPLY_T_REFUSED);
    assert_string_equal(r.message, "no seed");
    assert_int_equal(f->io.arbiter.record.commands_refused, 3);

    for (int i = 0; i < 65; i++) send_command(f, (trocar_command_t){.session = 4, .command = TROCAR_COMMAND_T_UNDO, .seq = 100 + i});
    assert_true(r.count == 5 && r.last.seq == 164);
    assert_non_null(strstr(r.message, "too many commands at once"));
    send_command(f, (trocar_command_t){.session = 4, .command = TROCAR_COMMAND_T_RELEASE, .seq = 200});
    assert_true(r.count == 6 && r.last.status == TROCAR_COMMAND_REPLY_T_DONE);
    trocar_command_reply_t_unsubscribe(f->io.lcm, s);
}

/* While a change is pending, its sender is told once a second to wait. */
static void a_pending_change_is_reported(void **state) {
    fixture *f = *state;
    replies r = {.count = 0};
    trocar_command_reply_t_subscription_t *s = trocar_command_reply_t_subscribe(f->io.lcm, "TROCAR_REPLY", on_reply, &r);
    f->io.changes.last = (needle_command){.asked = {.session = 6, .seq = 21, .command = TROCAR_COMMAND_T_CHANGE}};
    f->io.changes.pending = true;
    f->io.wait_shown = monotonic_ns() - 999000000;
    io_round(&f->io);
    io_round(&f->io);
    assert_int_equal(r.count, 0);
    f->io.wait_shown = monotonic_ns() - 1000000000;
    for (int i = 0; i < 4; i++) io_round(&f->io);
    assert_true(r.count == 1 && r.last.status == TROCAR_COMMAND_REPLY_T_PENDING && r.last.session == 6 && r.last.seq == 21 && r.last.command == TROCAR_COMMAND_T_CHANGE);
    assert_non_null(strstr(r.message, "not yet complete"));
    f->io.changes.pending = false;
    trocar_command_reply_t_unsubscribe(f->io.lcm, s);
}

static void bad_url_is_reported(void **unused) {
    (void)unused;
    exchange x;
    io o;
    trocar_error why;
    device_limits limits = device_defaults();
    assert_int_equal(exchange_create(&x, NULL, &why), TROCAR_OK);
    assert_int_equal(io_create(&o, "nonsense://x", 1, &limits, false, -1, &x, &why), TROCAR_OK);
    assert_int_equal(io_open(&o), TROCAR_BAD_INPUT);
    assert_non_null(strstr(o.why.text, "nonsense://x"));
    io_close(&o);
    io_free(&o);
    exchange_free(&x);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(one_round_reads_all_poses_and_keeps_the_newest, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(invalid_messages_are_counted, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(every_command_is_answered, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_pending_change_is_reported, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(all_wrenches_are_sent_in_order, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_release_reaches_the_loop, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_shutdown_wakes_the_server, open_fixture, close_fixture),
        cmocka_unit_test(bad_url_is_reported),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
