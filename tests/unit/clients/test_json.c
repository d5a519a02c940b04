#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "shared/json.h"

static char text[256];

static FILE *open_text(void) {
    memset(text, 0, sizeof text);
    return fmemopen(text, sizeof text, "w");
}

static void strings_are_quoted_and_escaped(void **state) {
    (void)state;
    json j = {.out = open_text()};
    json_text(&j, NULL, "a \"b\" \\ \n\x7f");
    fclose(j.out);
    assert_string_equal(text, "\"a \\u0022b\\u0022 \\u005c \\u000a\x7f\"");
}

static void times_are_members_in_seconds(void **state) {
    (void)state;
    static histogram h;
    histogram_clear(&h);
    for (int i = 0; i < 3; i++) histogram_add(&h, 50);
    json j = {.out = open_text()};
    json_time(&j, &h);
    fclose(j.out);
    assert_string_equal(text, "\"p50_s\": 5e-08, \"p99_s\": 5e-08, \"max_s\": 5e-08");
}

static void exact_numbers_are_read_as_the_same(void **state) {
    (void)state;
    json j = {.out = open_text()};
    json_open(&j, NULL, '{');
    json_time_stamp(&j, 1700000000.25);
    json_exact(&j, "third", 1.0 / 3);
    json_exact(&j, "none", INFINITY);
    json_xyz(&j, "v", v3(-1, NAN, 1e300));
    json_close(&j, '}');
    fclose(j.out);
    assert_string_equal(text, "{\"timestamp\": 1700000000.250000, \"third\": 0.33333333333333331, \"none\": null, \"v\": {\"x\": -1, \"y\": null, "
                              "\"z\": 1.0000000000000001e+300}}");
    assert_true(strtod(strstr(text, "0.3"), NULL) == 1.0 / 3);
}

static void documents_have_their_commas(void **state) {
    (void)state;
    json j = {.out = open_text()};
    json_open(&j, NULL, '{');
    json_line(&j), json_text(&j, "a", "b");
    json_line(&j), json_number(&j, "n", 0.5);
    json_number(&j, "none", NAN);
    json_numbers(&j, "v", (double[]){1, -2e-9}, 2);
    json_open(&j, "list", '[');
    json_open(&j, NULL, '{'), json_close(&j, '}');
    json_integer(&j, NULL, INT64_MIN);
    json_bool(&j, NULL, true);
    json_close(&j, ']');
    json_close(&j, '}');
    fclose(j.out);
    assert_string_equal(text, "{\n  \"a\": \"b\",\n  \"n\": 0.5, \"none\": null, \"v\": [1, -2e-09], \"list\": [{}, -9223372036854775808, true]}");
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(documents_have_their_commas),
                                       cmocka_unit_test(strings_are_quoted_and_escaped),
                                       cmocka_unit_test(times_are_members_in_seconds),
                                       cmocka_unit_test(exact_numbers_are_read_as_the_same)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
