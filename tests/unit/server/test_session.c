/* Tests that clients that start at the same time get different sessions. */
#include "common/session.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static void sessions_are_positive_and_differ(void **unused) {
    (void)unused;
    int64_t sessions[1000];
    for (int i = 0; i < 1000; i++) {
        sessions[i] = session_new();
        assert_true(sessions[i] > 0);
        for (int k = 0; k < i; k++) assert_true(sessions[k] != sessions[i]);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(sessions_are_positive_and_differ)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
