#include "events.h"
#include "insertion/insertion.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

static void events_become_words(void **state) {
    (void)state;
    char text[64];
    events_text(EVENT_PUNCTURED | EVENT_ADDED, "capsule", text, sizeof text);
    assert_string_equal(text, "puncture:capsule|added");
    events_text(0, "capsule", text, sizeof text);
    assert_string_equal(text, "");
    events_text(EVENT_WITHDRAWN, "", text, sizeof text);
    assert_string_equal(text, "withdrawn");
}

static void every_bit_has_a_word(void **state) {
    (void)state;
    char text[256];
    for (unsigned bit = EVENT_TOUCHED; bit <= EVENT_UNSTABLE; bit <<= 1) {
        events_text(bit, "", text, sizeof text);
        assert_true(strlen(text) > 0);
    }
}

static void long_text_is_cut(void **state) {
    (void)state;
    char text[16];
    memset(text, 'x', sizeof text);
    events_text(~0u, "capsule", text, 12);
    assert_string_equal(text, "touched|pun");
    assert_int_equal(text[12], 'x');
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(events_become_words),
        cmocka_unit_test(every_bit_has_a_word),
        cmocka_unit_test(long_text_is_cut),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
