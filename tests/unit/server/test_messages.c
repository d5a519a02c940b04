#include "common/messages.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static void wrench_message_is_complete(void **unused) {
    (void)unused;
    trocar_output w = {.force = {1, 2, 3}, .torque = {4, 5, 6}, .depth = 0.07, .contacts = 8, .events = TROCAR_EVENT_ADDED | TROCAR_EVENT_PUNCTURED, .membrane = 1};
    trocar_needle_wrench_t m = wrench_message(&w);
    const double force[] = {1, 2, 3}, torque[] = {4, 5, 6};
    assert_memory_equal(m.force, force, sizeof force);
    assert_memory_equal(m.raw_force, force, sizeof force);
    assert_memory_equal(m.torque, torque, sizeof torque);
    assert_memory_equal(m.raw_torque, torque, sizeof torque);
    assert_true(m.depth == 0.07);
    assert_int_equal(m.contacts, 8);
    assert_int_equal(m.events, TROCAR_EVENT_ADDED | TROCAR_EVENT_PUNCTURED);
    assert_int_equal(m.membrane, 1);
    assert_int_equal(m.flags, 0);
}

static void flags_follow_from_events(void **unused) {
    (void)unused;
    trocar_output w = {.events = TROCAR_EVENT_LATE, .membrane = -1};
    assert_int_equal(wrench_message(&w).flags, TROCAR_NEEDLE_WRENCH_T_LATE_WORKER);
    w.events = TROCAR_EVENT_UNSTABLE;
    assert_int_equal(wrench_message(&w).flags, TROCAR_NEEDLE_WRENCH_T_UNSTABLE);
    w.events = TROCAR_EVENT_MISSED_GUIDE;
    assert_int_equal(wrench_message(&w).flags, TROCAR_NEEDLE_WRENCH_T_MISSED_GUIDE);
    w.events = TROCAR_EVENT_OUTSIDE_MODEL;
    assert_int_equal(wrench_message(&w).flags, TROCAR_NEEDLE_WRENCH_T_OUTSIDE_MODEL);
    w.events = TROCAR_EVENT_UNSTABLE;
    w.events |= TROCAR_EVENT_LATE;
    assert_int_equal(wrench_message(&w).flags, TROCAR_NEEDLE_WRENCH_T_UNSTABLE | TROCAR_NEEDLE_WRENCH_T_LATE_WORKER);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(wrench_message_is_complete),
        cmocka_unit_test(flags_follow_from_events),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
