/* Tests which sequence numbers count as in order, and how a sender recovers after numbers that do not. */
#include "intake/sequence.h"

#include <stddef.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <cmocka.h>

/* Returns whether a message with this number is accepted. */
static bool take(sequence *s, int64_t number) {
    bool accepted = sequence_accepts(s, number);
    if (accepted) sequence_begin(s, number);
    return accepted;
}

static void numbers_increase_and_may_wrap(void **unused) {
    (void)unused;
    sequence s;
    sequence_begin(&s, INT64_MAX - 2);
    assert_true(take(&s, INT64_MAX - 1) && take(&s, INT64_MAX) && take(&s, INT64_MIN) && take(&s, INT64_MIN + 7));
    assert_false(take(&s, INT64_MIN + 7));
    assert_false(take(&s, INT64_MAX));
    assert_true(take(&s, INT64_MIN + 8));
}

static void gaps_are_counted_up_to_the_longest(void **unused) {
    (void)unused;
    sequence s;
    sequence_begin(&s, 10);
    assert_int_equal(sequence_gap(&s, 11), 0);
    assert_int_equal(sequence_gap(&s, 15), 4);
    assert_int_equal(sequence_gap(&s, 10), -1);
    assert_int_equal(sequence_gap(&s, 9), -1);
    assert_int_equal(sequence_gap(&s, 100000010), 99999999);
    assert_int_equal(sequence_gap(&s, 100000011), -1);
    assert_int_equal(sequence_gap(&s, INT64_MAX), -1);
    assert_int_equal(sequence_gap(&s, INT64_MIN), -1);
}

static void a_run_in_order_starts_a_new_count(void **unused) {
    (void)unused;
    sequence s;
    sequence_begin(&s, 1000);
    assert_true(!take(&s, 5) && !take(&s, 6) && take(&s, 7) && take(&s, 8));
    assert_true(!take(&s, 7) && !take(&s, 7) && !take(&s, 7) && !take(&s, 7)); /* repeated numbers are never in order */
    assert_true(!take(&s, 3) && !take(&s, 2) && !take(&s, 1)); /* nor these */
    assert_true(!take(&s, 2) && take(&s, 9));                  /* a valid number in between ends the run of invalid ones */
    assert_true(!take(&s, 3) && !take(&s, 4) && take(&s, 10));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(numbers_increase_and_may_wrap),
        cmocka_unit_test(gaps_are_counted_up_to_the_longest),
        cmocka_unit_test(a_run_in_order_starts_a_new_count),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
