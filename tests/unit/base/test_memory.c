/* Compares the machine's memory with sysconf. Control group limits are read from files that imitate the kernel's. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "base/memory.h"

#include <cmocka.h>

#include "check.h"

static void is_that_of_the_system(void **state) {
    (void)state;
    double page = (double)sysconf(_SC_PAGESIZE), total = page * (double)sysconf(_SC_PHYS_PAGES);
    assert_close(memory_total(), total, 0.01 * total);
    assert_true(memory_available() > 0.0 && memory_available() < memory_total());
}

static void most_is_no_less_than_available(void **state) {
    (void)state;
    assert_true(memory_most() <= memory_total());
    assert_true(memory_available() <= memory_most());
}

/* ---- control groups ---- */

static char root[] = "/tmp/test_memory.XXXXXX";

static void put(const char *folder, const char *name, const char *text) {
    char path[512];
    snprintf(path, sizeof path, "mkdir -p %s/%s", root, folder);
    assert_int_equal(system(path), 0);
    snprintf(path, sizeof path, "%s/%s/%s", root, folder, name);
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    fputs(text, file);
    fclose(file);
}

static void put_group(const char *folder, const char *limit, const char *used, const char *inactive) {
    char text[256];
    put(folder, "memory.max", limit);
    put(folder, "memory.current", used);
    snprintf(text, sizeof text, "anon 5\nactive_file 77\ninactive_file %s\nslab 3\n", inactive);
    put(folder, "memory.stat", text);
}

static void put_group_1(const char *folder, const char *limit, const char *used, const char *inactive) {
    char text[256];
    put(folder, "memory.limit_in_bytes", limit);
    put(folder, "memory.usage_in_bytes", used);
    snprintf(text, sizeof text, "cache 9\ninactive_file 1\ntotal_active_file 77\ntotal_inactive_file %s\n", inactive);
    put(folder, "memory.stat", text);
}

static void assert_limits(double most, double available) {
    memory_limits found = memory_of_groups(root);
    if (most < INFINITY) assert_close(found.most, most, 0.0);
    else assert_true(isinf(found.most));
    if (available < INFINITY) assert_close(found.available, available, 0.0);
    else assert_true(isinf(found.available));
}

static int create(void **state) {
    (void)state;
    return mkdtemp(root) ? 0 : -1;
}

/* Removes all files before each test case. */
static int clear(void **state) {
    (void)state;
    char command[128];
    snprintf(command, sizeof command, "rm -rf %s/proc %s/sys", root, root);
    return system(command);
}

static int destroy(void **state) { return clear(state) == 0 ? rmdir(root) : -1; }

static void without_groups_there_is_no_limit(void **state) {
    (void)state;
    assert_limits(INFINITY, INFINITY);
    put("proc/self", "cgroup", "0::/a\n");
    assert_limits(INFINITY, INFINITY);
    put_group("sys/fs/cgroup/a", "max\n", "300\n", "100");
    assert_limits(INFINITY, INFINITY);
    put("proc/self", "cgroup", "nonsense\n");
    assert_limits(INFINITY, INFINITY);
}

static void pages_of_files_are_given_back(void **state) {
    (void)state;
    put("proc/self", "cgroup", "0::/a\n");
    put_group("sys/fs/cgroup/a", "1000\n", "300\n", "100");
    assert_limits(1000.0, 800.0);
    put_group("sys/fs/cgroup/a", "1000\n", "1300\n", "100"); /* usage above the limit, as after lowering the limit */
    assert_limits(1000.0, 0.0);
}

/* The group with the least memory available is not necessarily the one with the lowest limit. */
static void groups_are_nested(void **state) {
    (void)state;
    put("proc/self", "cgroup", "0::/a/b.slice/c\n");
    put_group("sys/fs/cgroup/a/b.slice/c", "max\n", "100\n", "0");
    put_group("sys/fs/cgroup/a/b.slice", "1000\n", "200\n", "0");
    put_group("sys/fs/cgroup/a", "2000\n", "1900\n", "50");
    put_group("sys/fs/cgroup/other", "10\n", "5\n", "0");
    assert_limits(1000.0, 150.0);
    put_group("sys/fs/cgroup", "900\n", "800\n", "0"); /* the container's own control group */
    assert_limits(900.0, 100.0);
}

static void the_first_version_is_read(void **state) {
    (void)state;
    put("proc/self", "cgroup", "9:name=systemd:/s\n4:cpu,memory:/x/y\n3:cpuset:/z\n0::/\n");
    put_group_1("sys/fs/cgroup/memory/x/y", "9223372036854771712\n", "300\n", "0");
    put_group_1("sys/fs/cgroup/memory/x", "5000\n", "700\n", "200");
    put_group_1("sys/fs/cgroup/memory/z", "1\n", "1\n", "0");
    assert_limits(5000.0, 4500.0);
}

/* The path in /proc/self/cgroup refers to the host's file system, which a container does not see. */
static void a_container_has_its_group_at_the_top(void **state) {
    (void)state;
    put("proc/self", "cgroup", "4:memory:/docker/0123\n");
    put_group_1("sys/fs/cgroup/memory", "6000\n", "1000\n", "0");
    assert_limits(6000.0, 5000.0);
    put("proc/self", "cgroup", "4:memory:/../../0123\n");
    assert_limits(6000.0, 5000.0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(is_that_of_the_system),
        cmocka_unit_test(most_is_no_less_than_available),
        cmocka_unit_test_setup(without_groups_there_is_no_limit, clear),
        cmocka_unit_test_setup(pages_of_files_are_given_back, clear),
        cmocka_unit_test_setup(groups_are_nested, clear),
        cmocka_unit_test_setup(the_first_version_is_read, clear),
        cmocka_unit_test_setup(a_container_has_its_group_at_the_top, clear),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
