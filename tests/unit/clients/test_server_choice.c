/* Tests that a client sticks to the first of two servers until that one goes silent. */
#include "shared/server_choice.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static void first_server_is_followed_until_it_is_silent(void **unused) {
    (void)unused;
    server_choice c = {.patience = 0.1};
    assert_true(server_choice_follows(&c, 7, 1.00));
    assert_false(server_choice_has_other(&c, 1.00));
    assert_false(server_choice_follows(&c, 8, 1.05));
    assert_true(server_choice_follows(&c, 7, 1.06));
    assert_true(server_choice_has_other(&c, 1.06));
    assert_false(server_choice_follows(&c, 8, 1.15));
    assert_true(server_choice_follows(&c, 8, 1.17)); /* silent for more than 0.1 s */
    assert_int_equal(c.followed, 8);
    assert_false(server_choice_has_other(&c, 1.17));
    assert_false(server_choice_follows(&c, 7, 1.18));
}

static void another_server_is_forgotten_after_a_second(void **unused) {
    (void)unused;
    server_choice c = {.patience = 0.1};
    server_choice_follows(&c, 7, 5.0);
    server_choice_follows(&c, 8, 5.01);
    assert_true(server_choice_has_other(&c, 6.0));
    assert_false(server_choice_has_other(&c, 6.1));
}

/* While lcm-logplayer replays a log, a client follows the server recorded in it. */
static void replay_is_followed(void **unused) {
    (void)unused;
    server_choice c = {.patience = 0.1};
    assert_true(server_choice_follows(&c, 0, 1.0));
    assert_true(server_choice_follows(&c, 0, 9.0));
    assert_false(server_choice_follows(&c, 5, 9.01));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(first_server_is_followed_until_it_is_silent),
        cmocka_unit_test(another_server_is_forgotten_after_a_second),
        cmocka_unit_test(replay_is_followed),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
