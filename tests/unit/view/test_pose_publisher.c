/* Tests the messages of pose_publisher with a simulated clock (memq, no network). */
#include "view/hand/pose_publisher.h"

#include <pthread.h>

#include "common/timing.h"
#include "trocar_command_t.h"
#include "trocar_needle_pose_t.h"
#include "trocar_probe_pose_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "check.h"

static const int64_t MS = 1000000;
static const pose HOME = {{0, 0, -0.2}, {1, 0, 0, 0}};

typedef struct {
    pose_publisher pilot;
    lcm_t *lcm;
    trocar_needle_pose_t_subscription_t *on_pose;
    trocar_command_t_subscription_t *on_command;
    int64_t now;             /* ns */
    bool silent;             /* if set, no messages arrive from a server */
    int poses, commands;
    trocar_needle_pose_t pose;
    trocar_probe_pose_t_subscription_t *on_probe;
    int probe_poses;
    trocar_probe_pose_t probe;
    int32_t command;
    int64_t command_session;
    int32_t command_needle;
    int64_t command_seq;
    int32_t command_seeds;
} fixture;

static void on_pose(const lcm_recv_buf_t *b, const char *channel, const trocar_needle_pose_t *m, void *context) {
    (void)b, (void)channel;
    fixture *f = context;
    f->poses++;
    assert_int_equal(m->seq, f->poses - 1);
    f->pose = *m;
}

static void on_probe(const lcm_recv_buf_t *b, const char *channel, const trocar_probe_pose_t *m, void *context) {
    (void)b, (void)channel;
    fixture *f = context;
    assert_int_equal(m->seq, f->probe_poses);
    f->probe_poses++;
    f->probe = *m;
}

static void on_command(const lcm_recv_buf_t *b, const char *channel, const trocar_command_t *m, void *context) {
    (void)b, (void)channel;
    fixture *f = context;
    f->commands++;
    f->command = m->command;
    f->command_session = m->session;
    f->command_needle = m->needle;
    f->command_seq = m->seq;
    f->command_seeds = m->seeds;
}

static fixture *open_fixture(void) {
    static fixture f;
    trocar_error why;
    f = (fixture){.lcm = lcm_create("memq://"), .now = 1000 * MS};
    assert_non_null(f.lcm);
    f.on_pose = trocar_needle_pose_t_subscribe(f.lcm, "TROCAR_POSE", on_pose, &f);
    f.on_probe = trocar_probe_pose_t_subscribe(f.lcm, "TROCAR_PROBE", on_probe, &f);
    f.on_command = trocar_command_t_subscribe(f.lcm, "TROCAR_COMMAND", on_command, &f);
    assert_int_equal(publisher_create(&f.pilot, f.lcm, 0.2, &why), TROCAR_OK);
    return &f;
}

static void close_fixture(fixture *f) {
    publisher_free(&f->pilot);
    trocar_needle_pose_t_unsubscribe(f->lcm, f->on_pose);
    trocar_command_t_unsubscribe(f->lcm, f->on_command);
    trocar_probe_pose_t_unsubscribe(f->lcm, f->on_probe);
    lcm_destroy(f->lcm);
}

static bool run(fixture *f, int milliseconds) {
    bool goes_on = true;
    for (int i = 0; i < milliseconds; i++) {
        f->now += MS;
        if (!f->silent) publisher_hear(&f->pilot, f->now);
        goes_on = publisher_round(&f->pilot, f->now, 1e-3);
        while (lcm_handle_timeout(f->lcm, 0) > 0) continue;
    }
    return goes_on;
}

static void tell(fixture *f, order_kind kind, double forward) {
    publisher_tell(&f->pilot, &(publisher_order){.kind = kind, .home = HOME, .base = {{0.01, 0, -0.19}, {1, 0, 0, 0}}, .command = {.forward = forward}});
}

static void steer(fixture *f, rate_control_command command) { publisher_tell(&f->pilot, &(publisher_order){.kind = ORDER_STEER, .command = command}); }

static void sends_nothing_before_taking_the_needle(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    tell(f, ORDER_STEER, 1);
    run(f, 50);
    assert_int_equal(f->poses, 0);
    tell(f, ORDER_TAKE, 0);
    run(f, 50);
    assert_int_equal(f->poses, 50);
    assert_true(f->pose.session > 0 && f->pose.position[0] == 0.01 && f->pose.position[2] == -0.19); /* the requested start */
    tell(f, ORDER_STEER, 1);
    run(f, 50);
    assert_true(f->pose.position[2] > -0.19);
    close_fixture(f);
}

/* If the browser hangs, the needle ramps down to a stop after 0.25 s and stays there. */
static void needle_stops_without_orders(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    tell(f, ORDER_TAKE, 0);
    tell(f, ORDER_STEER, 1);
    run(f, 500);
    double stopped = f->pose.position[2];
    assert_true(stopped > -0.19 && stopped - -0.19 <= 0.04 * 0.45);
    int poses = f->poses;
    run(f, 200);
    assert_true(f->pose.position[2] == stopped);
    assert_int_equal(f->poses, poses + 200);
    close_fixture(f);
}

/* If no wrench arrives for 0.1 s, no hand can feel the needle, so it stops and no more poses are sent. When the server is heard again, poses continue from
   the last one. */
static void sends_nothing_without_a_server(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    tell(f, ORDER_TAKE, 0);
    for (int i = 0; i < 10; i++) tell(f, ORDER_STEER, 1), run(f, 50);
    f->silent = true;
    int poses = f->poses;
    double before = f->pose.position[2];
    for (int i = 0; i < 20; i++) tell(f, ORDER_STEER, 1), run(f, 50);
    assert_int_equal(f->poses, poses + 100);
    assert_close(f->pose.position[2], before + 0.1 * 0.04, 0.001 * 0.04);
    before = f->pose.position[2];
    f->silent = false;
    tell(f, ORDER_STEER, 0);
    run(f, 10);
    assert_int_equal(f->poses, poses + 110);
    assert_true(f->pose.position[2] == before);
    f->silent = true;
    run(f, 200);
    poses = f->poses;
    tell(f, ORDER_RELEASE, 0);
    f->silent = false;
    run(f, 10);
    assert_int_equal(f->poses, poses);
    assert_int_equal(f->command, TROCAR_COMMAND_T_RELEASE);
    close_fixture(f);
}

static void releases_the_needle(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    tell(f, ORDER_RELEASE, 0);
    run(f, 1);
    assert_int_equal(f->commands, 0); /* no command is sent, because the publisher owns no needle */
    tell(f, ORDER_TAKE, 0);
    run(f, 5);
    tell(f, ORDER_RELEASE, 0);
    run(f, 5);
    assert_int_equal(f->poses, 5);
    assert_int_equal(f->command, TROCAR_COMMAND_T_RELEASE);
    assert_true(f->command_session == f->pose.session);
    tell(f, ORDER_TAKE, 0);
    run(f, 5);
    tell(f, ORDER_END, 0);
    assert_false(run(f, 1));
    assert_int_equal(f->commands, 2);
    close_fixture(f);
}

static void reset_starts_at_home(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    tell(f, ORDER_TAKE, 0);
    run(f, 5);
    tell(f, ORDER_RESET, 0);
    run(f, 5);
    assert_int_equal(f->command, TROCAR_COMMAND_T_RESET);
    assert_true(f->pose.position[0] == 0 && f->pose.position[2] == -0.2);
    close_fixture(f);
}

/* Poses and commands name the needle. If the needle is taken twice without being released in between, only the first take counts. */
static void takes_one_needle_after_the_other(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    for (int needle = 2; needle >= 0; needle -= 2) {
        const pose home = {{0.01 * needle, 0, -0.2}, {1, 0, 0, 0}};
        publisher_tell(&f->pilot, &(publisher_order){.kind = ORDER_TAKE, .needle = needle, .home = home, .base = home});
        publisher_tell(&f->pilot, &(publisher_order){.kind = ORDER_TAKE, .needle = 3, .home = HOME, .base = HOME});
        run(f, 5);
        assert_true(f->pose.needle == needle && f->pose.position[0] == 0.01 * needle);
        tell(f, ORDER_RESET, 0);
        run(f, 5);
        assert_true(f->command == TROCAR_COMMAND_T_RESET && f->command_needle == needle && f->pose.position[0] == 0.01 * needle);
        tell(f, ORDER_RELEASE, 0);
        run(f, 5);
        assert_true(f->command == TROCAR_COMMAND_T_RELEASE && f->command_needle == needle);
    }
    close_fixture(f);
}

/* The thread wakes up when it gets an order, publishes at intervals measured by its own clock, and ends on request. */
static void thread_executes_orders(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    pthread_t thread;
    assert_int_equal(pthread_create(&thread, NULL, publisher_run, &f->pilot), 0);
    tell(f, ORDER_TAKE, 0);
    while (f->poses < 5) {
        publisher_hear(&f->pilot, monotonic_ns());
        lcm_handle_timeout(f->lcm, 100);
    }
    tell(f, ORDER_END, 0);
    pthread_join(thread, NULL);
    while (lcm_handle_timeout(f->lcm, 0) > 0) continue;
    assert_int_equal(f->command, TROCAR_COMMAND_T_RELEASE);
    close_fixture(f);
}

/* Only the holder of a needle may drop a seed, and every command has a number of its own. */
static void drops_and_takes_back_seeds(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    tell(f, ORDER_DROP, 0);
    run(f, 10);
    assert_int_equal(f->commands, 0);
    tell(f, ORDER_TAKE, 0);
    publisher_tell(&f->pilot, &(publisher_order){.kind = ORDER_DROP, .seeds = 3});
    run(f, 10);
    assert_true(f->commands == 1 && f->command == TROCAR_COMMAND_T_DROP_SEED && f->command_seeds == 3 && f->command_session == f->pose.session);
    int64_t first = f->command_seq;
    tell(f, ORDER_UNDO, 0);
    run(f, 10);
    assert_true(f->commands == 2 && f->command == TROCAR_COMMAND_T_UNDO && f->command_seq == first + 1);
    tell(f, ORDER_RELEASE, 0);
    publisher_tell(&f->pilot, &(publisher_order){.kind = ORDER_CLEAR, .needle = 3}); /* the server decides whether it may */
    run(f, 10);
    assert_true(f->command == TROCAR_COMMAND_T_CLEAR && f->command_seq == first + 3);
    close_fixture(f);
}

/* While the server is releasing a needle or handing it over, no poses are sent, because the server would refuse them. Losing a reply does not stop the
   needle for good. */
static void waits_while_a_needle_changes_hands(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    publisher_tell(&f->pilot, &(publisher_order){.kind = ORDER_TAKE, .needle = 2, .rests = true, .home = HOME, .base = {{0, 0, -0.15}, {1, 0, 0, 0}}});
    run(f, 100);
    assert_true(f->poses == 0 && f->commands == 1 && f->command == TROCAR_COMMAND_T_TAKE && f->command_needle == 2);
    tell(f, ORDER_GO_ON, 0);
    run(f, 10);
    assert_true(f->poses == 10 && f->pose.position[2] == -0.15);
    tell(f, ORDER_LEAVE, 0);
    run(f, 100);
    assert_true(f->poses == 10 && f->commands == 2 && f->command == TROCAR_COMMAND_T_LEAVE && f->command_needle == 2);
    tell(f, ORDER_GO_ON, 0); /* as if the server had refused the command */
    run(f, 10);
    assert_true(f->poses == 20 && f->pose.position[2] == -0.15);
    tell(f, ORDER_LEAVE, 0);
    run(f, 1990);
    assert_int_equal(f->poses, 20);
    run(f, 20);
    assert_true(f->poses > 20);
    close_fixture(f);
}

/* Another needle can be pulled out even if the thread holds none. */
static void pulls_out_a_needle_that_rests(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    publisher_tell(&f->pilot, &(publisher_order){.kind = ORDER_REMOVE, .needle = 4});
    run(f, 5);
    assert_true(f->commands == 1 && f->command == TROCAR_COMMAND_T_RESET && f->command_needle == 4 && f->poses == 0);
    tell(f, ORDER_TAKE, 0);
    publisher_tell(&f->pilot, &(publisher_order){.kind = ORDER_REMOVE, .needle = 4});
    run(f, 5);
    assert_true(f->commands == 2 && f->command_needle == 4 && f->poses == 5 && f->pose.needle == 0 && f->pose.position[0] == 0.01);
    close_fixture(f);
}

/* The needle moves to its new home pose by itself, at 80 mm/s, unless it is steered sideways. */
static void goes_to_a_hole_until_it_is_steered(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    publisher_order hole = {.kind = ORDER_HOLE, .home = {{0.03, 0, -0.2}, {1, 0, 0, 0}}};
    tell(f, ORDER_TAKE, 0);
    publisher_tell(&f->pilot, &hole);
    run(f, 125 + 2); /* it has been drawn back out of the template and moved 10 mm sideways */
    assert_close(f->pose.position[0], 0.01, 1e-3);
    assert_close(f->pose.position[2], -0.2, 1e-9);
    tell(f, ORDER_UNDO, 0); /* this does not stop the motion */
    for (int i = 0; i < 5; i++) tell(f, ORDER_STEER, 0), run(f, 50);
    assert_close(f->pose.position[0], 0.03, 1e-9);
    hole.home.position.x = 0;
    publisher_tell(&f->pilot, &hole);
    run(f, 50);
    steer(f, (rate_control_command){.up = 0.5});
    run(f, 100);
    tell(f, ORDER_STEER, 0);
    run(f, 200);
    double stopped = f->pose.position[0];
    assert_true(stopped > 0.02 && stopped < 0.029 && f->pose.position[1] > 0);
    tell(f, ORDER_STEER, 0);
    run(f, 200);
    assert_close(f->pose.position[0], stopped, 0);
    close_fixture(f);
}

/* The forward key is held down all the time: before the order to move to a hole, during that motion, and after the needle has been steered sideways again.
   The needle passes the plane in front of the template only where it is in line with the hole. */
static void pushing_forward_does_not_lead_into_another_hole(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    tell(f, ORDER_TAKE, 0);
    for (int i = 0; i < 6; i++) tell(f, ORDER_STEER, 1), run(f, 50);
    assert_true(f->pose.position[2] > -0.185); /* it is through the plate, 10 mm away from the hole ordered next */
    publisher_tell(&f->pilot, &(publisher_order){.kind = ORDER_HOLE, .home = HOME});
    for (int i = 0; i < 30; i++) {
        tell(f, ORDER_STEER, 1);
        run(f, 50);
        assert_true(f->pose.position[2] <= -0.2 || f->pose.position[0] == 0 || i < 6);
    }
    assert_true(f->pose.position[0] == 0 && f->pose.position[2] > -0.19); /* it has reached the hole and is advancing */
    publisher_tell(&f->pilot, &(publisher_order){.kind = ORDER_HOLE, .home = HOME});
    for (int i = 0; i < 40; i++) tell(f, ORDER_STEER, 0), run(f, 50);
    steer(f, (rate_control_command){.right = 1});
    run(f, 200);
    double aside = f->pose.position[0];
    assert_true(fabs(aside) > 1e-3);
    for (int i = 0; i < 10; i++) tell(f, ORDER_STEER, 1), run(f, 50);
    assert_true(f->pose.position[2] <= -0.2 + 1e-9 && fabs(f->pose.position[0]) >= fabs(aside));
    close_fixture(f);
}

/* While the probe moves, 100 poses per second are sent, starting at its current pose; at rest, none are. Without further orders, the probe stops. The needle
   does not move. */
static void moves_the_probe(void **unused) {
    (void)unused;
    fixture *f = open_fixture();
    publisher_order order = {.kind = ORDER_PROBE, .base = {{0.1, 0.2, -0.3}, {1, 0, 0, 0}}};
    publisher_tell(&f->pilot, &order); /* an order without motion */
    run(f, 100);
    assert_int_equal(f->probe_poses, 0);
    tell(f, ORDER_TAKE, 0);
    for (int i = 0; i < 20; i++) {
        order.command.forward = 1;
        publisher_tell(&f->pilot, &order);
        order.base.position.z = 7; /* this answer from the server comes too late and is not used */
        run(f, 50);
    }
    assert_in_range(f->probe_poses, 95, 101);
    assert_true(f->probe.session == f->pose.session && f->probe.position[0] == 0.1 && f->probe.position[1] == 0.2);
    assert_close(f->probe.position[2], -0.3 + 0.02 * (1 - 0.15 / 2), 3e-4);
    run(f, 500);
    int poses = f->probe_poses;
    assert_close(f->probe.position[2], -0.3 + 0.02 * 1.2, 5e-4); /* it stopped 0.25 s after the last order, 0.05 s before the end of the loop */
    run(f, 100);
    assert_int_equal(f->probe_poses, poses);
    assert_true(f->pose.position[2] == -0.19);
    order = (publisher_order){.kind = ORDER_PROBE, .base = order.base, .command = {.up = -1}};
    f->silent = true;
    run(f, 200);
    publisher_tell(&f->pilot, &order);
    run(f, 100);
    assert_int_equal(f->probe_poses, poses); /* no server */
    close_fixture(f);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sends_nothing_before_taking_the_needle),
        cmocka_unit_test(needle_stops_without_orders),
        cmocka_unit_test(sends_nothing_without_a_server),
        cmocka_unit_test(drops_and_takes_back_seeds),
        cmocka_unit_test(waits_while_a_needle_changes_hands),
        cmocka_unit_test(pulls_out_a_needle_that_rests),
        cmocka_unit_test(goes_to_a_hole_until_it_is_steered),
        cmocka_unit_test(pushing_forward_does_not_lead_into_another_hole),
        cmocka_unit_test(takes_one_needle_after_the_other),
        cmocka_unit_test(releases_the_needle),
        cmocka_unit_test(reset_starts_at_home),
        cmocka_unit_test(moves_the_probe),
        cmocka_unit_test(thread_executes_orders),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
