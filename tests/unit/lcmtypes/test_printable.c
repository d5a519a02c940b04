/* Tests that text from the network cannot control a terminal. */
#include "printable.h"

#include <stdio.h>
#include <string.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static void expect(const char *given, const char *wanted) {
    char text[64];
    snprintf(text, sizeof text, "%s", given);
    make_printable(text);
    assert_string_equal(text, wanted);
}

static void control_characters_are_replaced(void **unused) {
    (void)unused;
    expect("", "");
    expect("host, process 7", "host, process 7");
    expect("\033[2J\033]0;title\007gone\r\n\t\x7f", "?[2J?]0;title?gone????");
    expect("\xc2\x9b" "31m", "??31m"); /* U+009B is escape and bracket in one character */
}

static void letters_of_any_language_remain(void **unused) {
    (void)unused;
    expect("/home/jürgen/Größe Ω 東京 😀", "/home/jürgen/Größe Ω 東京 😀");
    expect("\u202egnp.exe", "???gnp.exe"); /* right-to-left override */
    expect("a\u2066b\ufeff", "a???b???");
}

static void bytes_that_form_no_character_are_replaced(void **unused) {
    (void)unused;
    expect("a\xff" "b", "a?b");
    expect("\xc3", "?");                /* cut off, as by a copy into a shorter buffer */
    expect("\xe6\x9d", "??");
    expect("\xc0\xaf", "??");           /* an overlong encoding */
    expect("\xe0\x80\x9b[", "???[");
    expect("\xed\xa0\x80", "???");      /* a surrogate */
    expect("\xf4\x90\x80\x80", "????"); /* beyond the last code point */
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(control_characters_are_replaced),
        cmocka_unit_test(letters_of_any_language_remain),
        cmocka_unit_test(bytes_that_form_no_character_are_replaced),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
