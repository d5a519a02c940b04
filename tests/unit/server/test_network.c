/* Tests that permanent network errors (bad input) are told apart from temporary ones. */
#include <stdlib.h>
#include <string.h>

#include "common/network.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static void expect(const char *url, trocar_status expected, const char *named) {
    lcm_t *lcm = NULL;
    trocar_error why = {""};
    assert_int_equal(network_open(url, &lcm, &why), expected);
    if (named != NULL) assert_non_null(strstr(why.text, named));
    if (expected == TROCAR_OK) lcm_destroy(lcm);
    else assert_null(lcm);
}

static void unknown_lcm_provider_is_bad_input(void **unused) {
    (void)unused;
    expect("nonsense://", TROCAR_BAD_INPUT, "nonsense://");
    expect("mpudpm://239.255.76.67:7667", TROCAR_BAD_INPUT, "mpudpm://"); /* a protocol that LCM supports, but not safely */
    expect("239.255.76.67:7667", TROCAR_BAD_INPUT, "udpm://GROUP:PORT");
}

static void missing_network_is_a_system_error(void **unused) {
    (void)unused;
    expect("udpm://nowhere:7667", TROCAR_SYSTEM, "nowhere");
    expect("udpm://nowhere:7667", TROCAR_SYSTEM, "ip route add nowhere/32 dev lo");
    expect("memq://", TROCAR_OK, NULL);
}

static void environment_sets_the_default_url(void **unused) {
    (void)unused;
    setenv("LCM_DEFAULT_URL", "nonsense://", 1);
    expect(NULL, TROCAR_BAD_INPUT, "nonsense://");
    expect("", TROCAR_BAD_INPUT, "nonsense://");
    expect("memq://", TROCAR_OK, NULL);
    setenv("LCM_DEFAULT_URL", "memq://", 1);
    expect(NULL, TROCAR_OK, NULL);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(unknown_lcm_provider_is_bad_input),
        cmocka_unit_test(missing_network_is_a_system_error),
        cmocka_unit_test(environment_sets_the_default_url),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
