/* A server that is killed in the middle of an insertion, under the loop that starts it again.
   usage: restart KEEP_ALIVE SERVER; in a private network namespace. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "scene.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "client.h"

#define SCENE MESHES "/figure8.yaml"

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

static int start(void **state) {
    static client c;
    char *const command[] = {programs[1], programs[2], "--scene", SCENE, "--allow-non-rt", NULL};
    *state = &c;
    started = monotonic_ns();
    return posix_spawn(&supervisor, command[0], NULL, NULL, command, environ) == 0 && client_open(&c, SCENE) ? 0 : -1;
}

static int stop(void **state) {
    int status = -1;
    kill(supervisor, SIGTERM);
    waitpid(supervisor, &status, 0);
    client_close(*state);
    return WIFEXITED(status) && WEXITSTATUS(status) == 0 ? 0 : -1;
}

static void a_killed_server_is_back_and_engages_by_a_ramp(void **state) {
    client *c = *state;
    PASS_UNTIL(c, c->wrenches > 0);
    double first = 1e-9 * (double)(monotonic_ns() - started);
    client_insert(c);
    double force = force_of(c);
    pid_t killed = server_of(supervisor);
    assert_true(killed > 0);

    kill(killed, SIGKILL);
    pass(c, 0.02);
    int64_t wrenches = c->wrenches, died = monotonic_ns();
    pass(c, 0.05);
    assert_int_equal(c->wrenches, wrenches); /* it stops: the device's own watchdog lets go */

    c->wrenches = 0; /* another server: no step from the last wrench of the first one is meant */
    PASS_UNTIL(c, c->wrenches > 0);
    double away = 1e-9 * (double)(monotonic_ns() - died);
    print_message("back after %.2f s; the first start took %.2f s\n", away + 0.02, first);
    if (in_time()) assert_true(away < 1.5 * first + 0.2); /* no longer than any start */
    assert_true(server_of(supervisor) != killed && c->wrench.tick < 1000);
    assert_true(force_of(c) < 0.2 * force); /* safe: nothing at once */

    watch(c);
    PASS_UNTIL(c, force_of(c) > 0.0 && c->wrench.pose_seq > 0);
    assert_true(c->seen & FLAG(RAMPING));
    assert_true(force_of(c) < 0.2 * force);
    pass(c, 0.3);
    assert_true(c->wrench.depth > 0.015); /* the needle is in the tissue, where it was */
    client_insert(c);                     /* drawn back, it goes in again as ever */
}

int main(int count, char **arguments) {
    if (count != 3) return 2;
    programs = arguments;
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_killed_server_is_back_and_engages_by_a_ramp)};
    return cmocka_run_group_tests(tests, start, stop);
}
