/* Tests clients/client/trocar_client.h against a live server: sending poses, receiving wrenches, and dropping the force to zero when the server dies. usage:
   device_client SERVER     (in a private network namespace) */
#define _GNU_SOURCE
#include <math.h>
#include <sched.h>
#include <signal.h>
#include <spawn.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "shared/allocator_calls.h"
#include "trocar_client.h"
#include "trocar_command_reply_t.h"
#include "trocar_command_t.h"
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"

static char *server_path;
static pid_t server;
static double position[3] = {0.005, 0.003, -0.201}; /* the tip is 1 mm in front of the skin */
static const double orientation[4] = {1, 0, 0, 0};

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double norm(const double a[3]) { return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }

static void start_server_with(char *scene) {
    char *const command[] = {server_path, "--scene", scene, "--allow-non-rt", NULL};
    assert_int_equal(posix_spawn(&server, command[0], NULL, NULL, command, environ), 0);
}

static void start_server(void) { start_server_with(MESHES "/figure8.yaml"); }

static void kill_server(void) {
    if (server == 0) return;
    kill(server, SIGKILL);
    waitpid(server, NULL, 0);
    server = 0;
}

/* Runs one period of the device loop. */
static int exchange(trocar_client *c, trocar_client_wrench *w) {
    nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
    assert_true(trocar_client_publish(c, position, orientation));
    return trocar_client_newest(c, w);
}

/* Holds the needle still and exchanges poses and wrenches until the force exceeds `least` (N). */
static void feel(trocar_client *c, trocar_client_wrench *w, double least) {
    double end = now() + 10;
    do {
        exchange(c, w);
        assert_true(now() < end);
    } while (!(norm(w->force) > least));
}

static void insert(trocar_client *c, trocar_client_wrench *w) {
    for (int i = 0; i < 210; i++) {
        position[2] += 0.1e-3;
        exchange(c, w);
    }
}

static int open_client(void **state) {
    char why[256] = "";
    position[2] = -0.201;
    *state = trocar_client_open(NULL, why, sizeof why);
    if (*state == NULL) print_error("%s\n", why);
    return *state != NULL ? 0 : -1;
}

static int close_client(void **state) {
    trocar_client_close(*state);
    kill_server();
    return 0;
}

/* Tests that poses arrive unchanged, judging by the depth the server reports, and that the exchange allocates no memory. */
static void poses_go_out_and_wrenches_come_in(void **state) {
    trocar_client *c = *state;
    trocar_client_wrench w;
    assert_false(exchange(c, &w));
    assert_true(norm(w.force) == 0 && norm(w.torque) == 0);
    start_server();
    for (double end = now() + 10; !exchange(c, &w);) assert_true(now() < end);
    trocar_client_reset(c);
    int64_t allocations = allocator_calls();
    insert(c, &w);
    feel(c, &w, 0.2);
    assert_int_equal(allocator_calls(), allocations);
    print_message("depth %.1f mm\n", 1e3 * w.depth);
    assert_true(w.depth > 0.010 && w.depth < 0.0201); /* the base advanced by 20 mm, and the tissue gave way by part of that */
    assert_true(w.contacts > 0 && w.tick > 0);

    double nowhere[3] = {NAN, 0, 0};
    assert_false(trocar_client_publish(c, nowhere, orientation));
}

/* A second device feels no force while the first owns the needle, and can take the needle over once the first has stopped. */
static void one_device_at_a_time(void **state) {
    trocar_client *first = *state, *second = trocar_client_open(NULL, NULL, 0);
    trocar_client_wrench w;
    assert_non_null(second);
    start_server();
    for (double end = now() + 10; !exchange(first, &w);) assert_true(now() < end);
    insert(first, &w);
    feel(first, &w, 0.2);
    for (int i = 0; i < 100; i++) {
        exchange(first, &w);
        assert_false(exchange(second, &w));
        assert_true(norm(w.force) == 0);
    }
    trocar_client_close(first);
    *state = second;
    for (double end = now() + 1; !exchange(second, &w);) assert_true(now() < end);
}

/* Writes the scene with two needles to a temporary file. `path` is a template for mkstemp. */
static void write_pair(char path[]) {
    FILE *in = fopen(MESHES "/figure8.yaml", "r"), *out = fdopen(mkstemp(path), "w");
    assert_true(in && out);
    for (char line[256]; fgets(line, sizeof line, in);)
        if (strncmp(line, "mesh: ", 6) == 0) fprintf(out, "mesh: " MESHES "/%s", line + 6);
        else fputs(line, out);
    /* rigid, because through a virtual coupling the force would also depend on the delay, which varies on a busy machine */
    fputs("needles: 2\ndevice: {max_stiffness: .inf}\n", out);
    fclose(in);
    fclose(out);
}

/* Runs one period of both devices' loops, with the needles parallel and 60 mm apart. */
static void exchange_pair(trocar_client *const clients[2], trocar_client_wrench w[2]) {
    nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
    for (int n = 0; n < 2; n++) {
        double at[3] = {n == 0 ? -0.03 : 0.03, position[1], position[2]};
        assert_true(trocar_client_publish(clients[n], at, orientation));
        trocar_client_newest(clients[n], &w[n]);
    }
}

/* Resetting one needle removes its force without affecting the other. A third client gets no needle. */
static void two_clients_hold_two_needles(void **state) {
    char scene[] = "/tmp/trocar-pair-XXXXXX";
    write_pair(scene);
    const trocar_client_options second = {.needle = 1}, third = {.needle = 2};
    trocar_client *clients[2] = {*state, trocar_client_open(&second, NULL, 0)}, *none = trocar_client_open(&third, NULL, 0);
    trocar_client_wrench w[2], nothing;
    assert_true(clients[1] && none);
    start_server_with(scene);
    double end = now() + 10;
    do {
        exchange_pair(clients, w);
        assert_true(now() < end);
    } while (w[0].tick == 0 || w[1].tick == 0);
    for (int i = 0; i < 310; i++) {
        position[2] += 0.1e-3;
        exchange_pair(clients, w);
    }
    for (int i = 0; i < 200; i++) exchange_pair(clients, w);
    print_message("forces %.3f N and %.3f N\n", norm(w[0].force), norm(w[1].force));
    assert_true(norm(w[0].force) > 0.2 && norm(w[1].force) > 0.2);

    double force = norm(w[1].force), depth = w[1].depth;
    assert_false(exchange(none, &nothing));
    trocar_client_reset(clients[0]);
    for (int i = 0; i < 300; i++) {
        exchange_pair(clients, w);
        assert_true(fabs(norm(w[1].force) - force) < 0.1 * force && fabs(w[1].depth - depth) < 1e-3);
    }
    print_message("after the reset of one %.3f N and %.3f N\n", norm(w[0].force), norm(w[1].force));
    assert_true(norm(w[0].force) < 0.1 * force); /* after a reset inside the tissue, the needle counts as inserted and carries no force */

    assert_false(exchange(none, &nothing));
    trocar_client_close(clients[1]);
    trocar_client_close(none);
    unlink(scene);
}

static void on_pose(const lcm_recv_buf_t *received, const char *channel, const trocar_needle_pose_t *m, void *session) {
    (void)received, (void)channel;
    *(int64_t *)session = m->session;
}

/* The device must ignore wrenches that answer its own session but concern another needle, which the session may have held before. The test sends these
   wrenches in the server's place. */
static void wrenches_of_other_needles_are_ignored(void **state) {
    trocar_client *c = *state;
    trocar_client_wrench w;
    trocar_needle_wrench_t sent = {.server = 5, .force = {9, 0, 0}, .needle = 1};
    lcm_t *lcm = lcm_create(NULL);
    assert_non_null(lcm);
    trocar_needle_pose_t_subscription_t *poses = trocar_needle_pose_t_subscribe(lcm, "TROCAR_POSE", on_pose, &sent.session);
    for (double end = now() + 10; sent.session == 0; lcm_handle_timeout(lcm, 10)) {
        exchange(c, &w);
        assert_true(now() < end);
    }
    for (int i = 0; i < 100; i++) {
        trocar_needle_wrench_t_publish(lcm, "TROCAR_WRENCH", &sent);
        assert_false(exchange(c, &w));
    }
    sent.needle = 0;
    double end = now() + 10;
    do {
        trocar_needle_wrench_t_publish(lcm, "TROCAR_WRENCH", &sent);
        assert_true(now() < end);
    } while (!exchange(c, &w) || w.force[0] != 9); /* repeated, because the force ramps up */
    trocar_needle_pose_t_unsubscribe(lcm, poses);
    lcm_destroy(lcm);
}

/* One wrench may overtake another on the network, but the force must never go back to that of an older one. If the server restarts its numbering, its
   wrenches are accepted once the last one from before has expired. */
static void overtaken_wrenches_are_dropped(void **state) {
    trocar_client *c = *state;
    trocar_client_wrench w;
    trocar_needle_wrench_t sent = {.server = 5};
    lcm_t *lcm = lcm_create(NULL);
    assert_non_null(lcm);
    trocar_needle_pose_t_subscription_t *poses = trocar_needle_pose_t_subscribe(lcm, "TROCAR_POSE", on_pose, &sent.session);
    for (double end = now() + 10; sent.session == 0; lcm_handle_timeout(lcm, 10)) {
        exchange(c, &w);
        assert_true(now() < end);
    }
    int64_t newest = 0;
    int dropped = 0;
    for (int64_t tick = 1000; tick < 1400; tick += 4) {
        static const int order[] = {2, 0, 3, 1};
        for (int i = 0; i < 4; i++) {
            sent.tick = tick + order[i];
            trocar_needle_wrench_t_publish(lcm, "TROCAR_WRENCH", &sent);
            if (!exchange(c, &w)) continue; /* a busy machine may miss a wrench */
            assert_true(w.tick >= newest);
            dropped += w.tick > sent.tick;
            newest = w.tick;
        }
    }
    print_message("%d of 400 wrenches dropped\n", dropped);
    assert_true(newest == 1399 && dropped > 100);
    sent.tick = 3;
    double begin = now(), end = begin + 10;
    do {
        trocar_needle_wrench_t_publish(lcm, "TROCAR_WRENCH", &sent);
        assert_true(now() < end);
    } while (!exchange(c, &w) || w.tick != 3);
    print_message("heard again after %.1f ms\n", 1e3 * (now() - begin));
    trocar_needle_pose_t_unsubscribe(lcm, poses);
    lcm_destroy(lcm);
}

/* Sends wrenches of 1000 N, as anyone on the network could by posing as the server: first a single one that looks like the newest, then a continuous stream. */
static void forged_wrenches_are_limited(void **state) {
    const trocar_client_options limited = {.max_force = 8, .max_torque = 0.1, .max_force_rate = 500, .max_torque_rate = 10};
    trocar_client *const clients[] = {*state, trocar_client_open(&limited, NULL, 0)};
    const double most[] = {20, 8}, turn[] = {1, 0.1}, rate[] = {2000, 500};
    lcm_t *lcm = lcm_create(NULL);
    assert_true(clients[1] && lcm);
    int64_t other = 0; /* session of the previous client, whose last pose may still be in transit */
    for (int k = 0; k < 2; k++) {
        trocar_client_wrench w;
        trocar_needle_wrench_t sent = {.server = 5, .session = other, .force = {0.3, 0, 0}};
        double last = 0, at, forged = 0, torque = 0;
        trocar_needle_pose_t_subscription_t *poses = trocar_needle_pose_t_subscribe(lcm, "TROCAR_POSE", on_pose, &sent.session);
        for (double end = now() + 10; sent.session == other; lcm_handle_timeout(lcm, 10)) {
            exchange(clients[k], &w);
            assert_true(now() < end);
        }
        trocar_needle_pose_t_unsubscribe(lcm, poses);
        other = sent.session;
        at = now();
        for (int i = 0; i < 600; i++) {
            bool forges = i == 300 || i > 400;
            sent.force[0] = forges ? 1000 : 0.3;
            sent.torque[2] = forges ? -50 : 0;
            trocar_needle_wrench_t_publish(lcm, "TROCAR_WRENCH", &sent);
            double before = at;
            bool answered = exchange(clients[k], &w);
            if (!answered) last = 0; /* the watchdog has expired, as may happen on a busy machine */
            at = now();
            assert_true(norm(w.force) <= most[k] * (1 + 1e-12) && norm(w.torque) <= turn[k] * (1 + 1e-12));
            assert_true(fabs(norm(w.force) - last) <= rate[k] * (at - before + 1e-3));
            last = norm(w.force);
            forged = fmax(forged, last);
            torque = fmax(torque, norm(w.torque));
            if (i >= 500 && answered) assert_true(w.flags & TROCAR_NEEDLE_WRENCH_T_SATURATED); /* the last 100 periods have only forged wrenches */
        }
        print_message("1000 N rendered as %.2f N, 50 N m as %.2f N m\n", forged, torque);
        assert_true(forged > 0.9 * most[k] && torque > 0.9 * turn[k]);
    }
    lcm_destroy(lcm);
    trocar_client_close(clients[1]);
    char why[256];
    assert_null(trocar_client_open(&(trocar_client_options){.max_force = -1}, why, sizeof why));
    assert_non_null(strstr(why, "max_force"));
    assert_null(trocar_client_open(&(trocar_client_options){.max_torque_rate = NAN}, why, sizeof why));
}

static void on_command(const lcm_recv_buf_t *received, const char *channel, const trocar_command_t *m, void *newest) {
    (void)received, (void)channel;
    *(trocar_command_t *)newest = *m;
}

/* Acts as the server and waits for a command of this kind. */
static trocar_command_t hear_command(lcm_t *lcm, const trocar_command_t *heard, int what) {
    for (double end = now() + 10; heard->command != what; lcm_handle_timeout(lcm, 10)) assert_true(now() < end);
    return *heard;
}

static void answer(lcm_t *lcm, trocar_command_t c, int status, char *message) {
    trocar_command_reply_t m = {.server = 5, .session = c.session, .seq = c.seq, .command = c.command, .needle = c.needle, .status = status, .message = message};
    trocar_command_reply_t_publish(lcm, "TROCAR_REPLY", &m);
}

static trocar_client_answer await_answer(trocar_client *c, char why[64]) {
    trocar_client_answer found;
    for (double end = now() + 10; (found = trocar_client_reply(c, why, 64)) == TROCAR_CLIENT_WAITING; nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL))
        assert_true(now() < end);
    return found;
}

/* Commands carry the caller's arguments, and only one may be pending at a time. Only a reply to the last command is accepted. Replies to another session,
   another needle or an older command are ignored, as are bytes that are not a reply. */
static void commands_are_answered(void **state) {
    trocar_client *c = *state;
    char why[64];
    trocar_command_t heard = {0}, m;
    lcm_t *lcm = lcm_create(NULL);
    assert_non_null(lcm);
    trocar_command_t_subscription_t *commands = trocar_command_t_subscribe(lcm, "TROCAR_COMMAND", on_command, &heard);
    assert_int_equal(trocar_client_reply(c, why, sizeof why), TROCAR_CLIENT_NONE);

    assert_true(trocar_client_drop_seeds(c, 3, 9e-3));
    m = hear_command(lcm, &heard, TROCAR_COMMAND_T_DROP_SEED);
    assert_true(m.needle == 0 && m.seeds == 3 && m.spacing == 9e-3 && m.session != 0);
    assert_false(trocar_client_undo(c));
    trocar_command_t other = m;
    other.session++;
    answer(lcm, other, TROCAR_COMMAND_REPLY_T_DONE, "");
    other = m, other.needle++;
    answer(lcm, other, TROCAR_COMMAND_REPLY_T_DONE, "");
    other = m, other.seq++;
    answer(lcm, other, TROCAR_COMMAND_REPLY_T_DONE, "");
    lcm_publish(lcm, "TROCAR_REPLY", "not a reply", 11);
    answer(lcm, m, TROCAR_COMMAND_REPLY_T_REFUSED, "outside of the tissue");
    assert_int_equal(await_answer(c, why), TROCAR_CLIENT_REFUSED);
    assert_string_equal(why, "outside of the tissue");

    const struct { int (*ask)(trocar_client *); int what; } others[] = {
        {trocar_client_leave, TROCAR_COMMAND_T_LEAVE}, {trocar_client_take, TROCAR_COMMAND_T_TAKE},
        {trocar_client_undo, TROCAR_COMMAND_T_UNDO}, {trocar_client_reset, TROCAR_COMMAND_T_RESET}, {trocar_client_clear, TROCAR_COMMAND_T_CLEAR}};
    for (int i = 0; i < 5; i++) {
        assert_true(others[i].ask(c));
        trocar_command_t next = hear_command(lcm, &heard, others[i].what);
        answer(lcm, m, TROCAR_COMMAND_REPLY_T_REFUSED, "an old one");
        answer(lcm, next, TROCAR_COMMAND_REPLY_T_DONE, "");
        assert_int_equal(await_answer(c, why), TROCAR_CLIENT_DONE);
        assert_string_equal(why, "");
        m = next;
    }
    /* Tests a reply of two fragments, and one of three, which is longer than the client accepts. */
    static char lengthy[150000];
    memset(lengthy, 'x', sizeof lengthy - 1);
    assert_true(trocar_client_undo(c));
    memset(&heard, 0, sizeof heard);
    m = hear_command(lcm, &heard, TROCAR_COMMAND_T_UNDO);
    lengthy[70000] = '\0';
    answer(lcm, m, TROCAR_COMMAND_REPLY_T_REFUSED, lengthy);
    assert_int_equal(await_answer(c, why), TROCAR_CLIENT_REFUSED);
    assert_true(strlen(why) == sizeof why - 1 && strspn(why, "x") == sizeof why - 1);
    assert_true(trocar_client_undo(c));
    memset(&heard, 0, sizeof heard);
    m = hear_command(lcm, &heard, TROCAR_COMMAND_T_UNDO);
    lengthy[70000] = 'x';
    answer(lcm, m, TROCAR_COMMAND_REPLY_T_REFUSED, lengthy);
    answer(lcm, m, TROCAR_COMMAND_REPLY_T_DONE, "\033[2Jdone");
    assert_int_equal(await_answer(c, why), TROCAR_CLIENT_DONE);
    assert_string_equal(why, "?[2Jdone");

    assert_true(trocar_client_leave(c));
    assert_int_equal(await_answer(c, why), TROCAR_CLIENT_UNANSWERED);
    assert_non_null(strstr(why, "no reply from the server"));
    assert_true(trocar_client_leave(c));
    trocar_command_t_unsubscribe(lcm, commands);
    lcm_destroy(lcm);
}

/* The server is killed in the middle of an insertion. The force drops to zero within the watchdog's timeout and stays there. With the next server, it ramps
   up. */
static void no_force_from_a_dead_server(void **state) {
    trocar_client *c = *state;
    trocar_client_wrench w;
    start_server();
    for (double end = now() + 10; !exchange(c, &w);) assert_true(now() < end);
    insert(c, &w);
    feel(c, &w, 0.2);
    kill(server, SIGKILL); /* stops the server's threads at once; waiting for its exit takes longer */
    double killed = now(), last = killed;
    while (now() < killed + 0.3)
        if (exchange(c, &w)) last = now();
        else assert_true(norm(w.force) == 0 && norm(w.torque) == 0);
    print_message("force for %.1f ms after the server's death\n", 1e3 * (last - killed));
    assert_true(last - killed < 0.0225); /* the watchdog's 20 ms, plus one period of this loop and the delay of messages still in transit */

    kill_server();
    start_server();
    position[2] = -0.201 + 0.021; /* moves the needle deeper, to cause friction; on a busy machine, the watchdog may remove the force in a single step */
    double force = 0, largest_step = 0;
    for (double end = now() + 2; now() < end;) {
        position[2] += 2e-6;
        exchange(c, &w);
        largest_step = fmax(largest_step, norm(w.force) - force);
        force = norm(w.force);
    }
    assert_true(force > 0.05);
    print_message("back at %.2f N, largest rise per step %.3f N\n", force, largest_step);
    assert_true(largest_step < 0.2);
}

static void a_bad_address_is_refused_with_a_message(void **state) {
    (void)state;
    char why[256] = "";
    trocar_client_options options = {.url = "nonsense://x"};
    assert_null(trocar_client_open(&options, why, sizeof why));
    assert_non_null(strstr(why, "nonsense://x"));
    trocar_client_close(NULL);
}

int main(int count, char **arguments) {
    if (count != 2) return 2;
    server_path = arguments[1];
    sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){.sched_priority = 70}); /* as a real device would use; may be refused */
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_bad_address_is_refused_with_a_message),
        cmocka_unit_test_setup_teardown(poses_go_out_and_wrenches_come_in, open_client, close_client),
        cmocka_unit_test_setup_teardown(one_device_at_a_time, open_client, close_client),
        cmocka_unit_test_setup_teardown(two_clients_hold_two_needles, open_client, close_client),
        cmocka_unit_test_setup_teardown(wrenches_of_other_needles_are_ignored, open_client, close_client),
        cmocka_unit_test_setup_teardown(overtaken_wrenches_are_dropped, open_client, close_client),
        cmocka_unit_test_setup_teardown(forged_wrenches_are_limited, open_client, close_client),
        cmocka_unit_test_setup_teardown(commands_are_answered, open_client, close_client),
        cmocka_unit_test_setup_teardown(no_force_from_a_dead_server, open_client, close_client),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
