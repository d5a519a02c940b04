#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "common/host_port.h"

static void check_split(const char *text, const char *standard_port, const char *wanted_host, const char *wanted_port) {
    char host[256], port[6];
    if (!split_host_port(text, standard_port, host, port)) fail_msg("'%s' is refused", text);
    assert_string_equal(host, wanted_host);
    assert_string_equal(port, wanted_port);
}

static void hosts_and_ports_are_split(void **state) {
    (void)state;
    check_split("localhost:9870", NULL, "localhost", "9870");
    check_split("localhost:9870", "10001", "localhost", "9870");
    check_split("localhost", "10001", "localhost", "10001");
    check_split("192.0.2.1:065535", NULL, "192.0.2.1", "65535");
    check_split("[::1]:1", "10001", "::1", "1");
    check_split("[fe80::1%eth0]", "10001", "fe80::1%eth0", "10001");
}

static void malformed_ones_are_refused(void **state) {
    (void)state;
    static const char *const wrong[] = {"", ":", ":1", "a:", "a:0", "a:65536", "a:99999999999999999999", "a:-1", "a:+1", "a: 1", "a:1x", "a:b",
                                        "::1", "::1:9870", "fe80::1", "[]", "[]:1", "[::1", "[::1:1", "[::1]1", "[::1]:", "[::1]x:1"};
    char host[256], port[6], longest[300];
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++)
        if (split_host_port(wrong[i], "10001", host, port)) fail_msg("'%s' is taken for host '%s', port %s", wrong[i], host, port);
    assert_false(split_host_port("localhost", NULL, host, port));
    assert_false(split_host_port("[::1]", NULL, host, port));
    memset(longest, 'x', sizeof longest);
    strcpy(longest + 255, ":1");
    assert_true(split_host_port(longest, NULL, host, port));
    strcpy(longest + 255, "x:1");
    assert_false(split_host_port(longest, NULL, host, port));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(hosts_and_ports_are_split),
        cmocka_unit_test(malformed_ones_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
