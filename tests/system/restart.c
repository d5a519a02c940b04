/* Tests a server that is killed in the middle of an insertion, or finds no network, and the script that restarts it. usage: restart KEEP_ALIVE SERVER     (in a
   private network namespace) */
#define _GNU_SOURCE
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "scene/scene.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "client.h"

#define SCENE MESHES "/figure8.yaml"

static const double BACK = 1.0;      /* s, maximum time from the server's death to the next wrench */

static char *const *programs;
static pid_t supervisor;
static int64_t started;              /* ns */

static pid_t server_of(pid_t parent) {
    char path[64], text[32] = "";
    snprintf(path, sizeof path, "/proc/%d/task/%d/children", parent, parent);
    int file = open(path, O_RDONLY);
    ssize_t length = file >= 0 ? read(file, text, sizeof text - 1) : 0;
    if (file >= 0) close(file);
    return length > 0 ? (pid_t)strtol(text, NULL, 10) : 0;
}

static bool start_supervisor(void) {
    char *const command[] = {programs[1], programs[2], "--scene", SCENE, "--allow-non-rt", NULL};
    started = monotonic_ns();
    return posix_spawn(&supervisor, command[0], NULL, NULL, command, environ) == 0;
}

static int start(void **state) {
    static client c;
    *state = &c;
    return start_supervisor() && client_open(&c, SCENE) ? 0 : -1;
}

static int stop(void **state) {
    int status = -1;
    kill(supervisor, SIGTERM);
    waitpid(supervisor, &status, 0);
    client_close(*state);
    return WIFEXITED(status) && WEXITSTATUS(status) == 0 ? 0 : -1;
}

/* Kills the server. Returns the time (s) until the next server's first wrench. */
static double kill_server(client *c) {
    pid_t killed = server_of(supervisor);
    assert_true(killed > 0);
    int64_t died = monotonic_ns();
    kill(killed, SIGKILL);
    pass(c, 0.02);
    int64_t wrenches = c->wrenches;
    pass(c, 0.05);
    assert_int_equal(c->wrenches, wrenches); /* no more wrenches have arrived; the device's own watchdog removes the force */

    c->wrenches = 0; /* keeps the new server's first wrench from being compared with the old server's last */
    PASS_UNTIL(c, c->wrenches > 0);
    assert_true(server_of(supervisor) != killed && c->wrench.tick < 1000);
    return 1e-9 * (double)(monotonic_ns() - died);
}

/* Returns false on a machine so overloaded that starting the server takes seconds. */
static bool machine_has_room(void) {
    double load;
    return getloadavg(&load, 1) == 1 && load < 2.0 * (double)sysconf(_SC_NPROCESSORS_ONLN);
}

static void a_killed_server_is_back_and_engages_by_a_ramp(void **state) {
    client *c = *state;
    PASS_UNTIL(c, c->wrenches > 0);
    double first = 1e-9 * (double)(monotonic_ns() - started), shortest = INFINITY; /* the shortest of three restarts counts, because the machine may be busy */
    for (int attempts = in_time() ? 3 : 1; attempts > 0 && !(shortest < BACK); attempts--) {
        client_insert(c);
        double force = force_of(c), away = kill_server(c);
        print_message("back after %.2f s; the first start took %.2f s\n", away, first);
        shortest = fmin(shortest, away);
        assert_true(force_of(c) < 0.2 * force); /* no sudden force */

        watch(c);
        /* (the force is not checked, because a needle that starts in the tissue carries no force at rest) */
        PASS_UNTIL(c, c->seen & FLAG(RAMPING) && c->wrench.pose_seq > 0);
        assert_true(c->most < 0.2 * force);
        pass(c, 0.3);
        assert_true(c->wrench.depth > 0.015); /* the needle is still in the tissue */
    }
    if (in_time()) assert_true(shortest < (machine_has_room() ? BACK : 1.5 * first + 0.2)); /* on an overloaded machine, a restart takes about as long as an
                                                                                               ordinary start */
    client_insert(c); /* the needle can be withdrawn and inserted again */
}

static int start_without_route(void **state) {
    static client c;
    *state = &c;
    return system("ip route del 224.0.0.0/4 dev lo") == 0 && start_supervisor() ? 0 : -1;
}

/* As during boot, the server is restarted until the network is up. */
static void a_server_without_a_route_comes_up_once_there_is_one(void **state) {
    int64_t end = monotonic_ns() + 20000000000;
    pid_t first = 0, now = 0;
    for (; now == first && monotonic_ns() < end; usleep(10000)) {
        now = server_of(supervisor);
        if (first == 0) first = now;
        if (now == 0) now = first; /* between two servers */
    }
    assert_true(now != first);

    assert_int_equal(system("ip route add 224.0.0.0/4 dev lo"), 0);
    assert_true(client_open(*state, SCENE));
    client_insert(*state);
}

int main(int count, char **arguments) {
    if (count != 3) return 2;
    programs = arguments;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_killed_server_is_back_and_engages_by_a_ramp, start, stop),
        cmocka_unit_test_setup_teardown(a_server_without_a_route_comes_up_once_there_is_one, start_without_route, stop),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
