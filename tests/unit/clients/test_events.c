#include "shared/events.h"
#include "trocar.h"
#include "trocar_needle_wrench_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

static void events_are_formatted_as_words(void **state) {
    (void)state;
    char text[64];
    events_text(TROCAR_EVENT_PUNCTURED | TROCAR_EVENT_ADDED, "capsule", text, sizeof text);
    assert_string_equal(text, "puncture:capsule|added");
    events_text(0, "capsule", text, sizeof text);
    assert_string_equal(text, "");
    events_text(TROCAR_EVENT_WITHDRAWN, "", text, sizeof text);
    assert_string_equal(text, "withdrawn");
}

static void every_event_bit_has_a_name(void **state) {
    (void)state;
    char text[256];
    for (unsigned bit = TROCAR_EVENT_TOUCHED; bit <= TROCAR_EVENT_INEXACT; bit <<= 1) {
        events_text(bit, "", text, sizeof text);
        assert_true(strlen(text) > 0);
    }
}

static void long_text_is_truncated(void **state) {
    (void)state;
    char text[16];
    memset(text, 'x', sizeof text);
    events_text(~0u, "capsule", text, 12);
    assert_string_equal(text, "touched|pun");
    assert_int_equal(text[12], 'x');
}

static void messages_and_library_mean_the_same_bits(void **state) {
    (void)state;
#define SAME(library, message) assert_int_equal(TROCAR_EVENT_##library, TROCAR_NEEDLE_WRENCH_T_EVENT_##message)
    SAME(TOUCHED, TOUCHED), SAME(PUNCTURED, PUNCTURE), SAME(ADDED, ADDED), SAME(REMOVED, REMOVED), SAME(EXITED, EXITED);
    SAME(REENTERED, REENTERED), SAME(WITHDRAWN, WITHDRAWN), SAME(LATE, LATE), SAME(FULL, FULL), SAME(UNSTABLE, UNSTABLE), SAME(KEPT, KEPT);
    SAME(MISSED_GUIDE, MISSED_GUIDE), SAME(OUTSIDE_MODEL, OUTSIDE_MODEL), SAME(TRACK_DROPPED, TRACK_DROPPED), SAME(INEXACT, INEXACT);
#undef SAME
}

static void flags_become_words(void **state) {
    (void)state;
    char text[64];
    flags_text(TROCAR_NEEDLE_WRENCH_T_STALE | TROCAR_NEEDLE_WRENCH_T_NOT_REALTIME, text, sizeof text);
    assert_string_equal(text, "stale, not_realtime");
    flags_text(0, text, sizeof text);
    assert_string_equal(text, "");
    unsigned bit, all = 0;
    const char *word;
    for (int i = 0; flag_at(i, &bit, &word); i++) all |= bit;
    assert_int_equal(all, 2047);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(events_are_formatted_as_words),
        cmocka_unit_test(every_event_bit_has_a_name),
        cmocka_unit_test(long_text_is_truncated),
        cmocka_unit_test(messages_and_library_mean_the_same_bits),
        cmocka_unit_test(flags_become_words),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
