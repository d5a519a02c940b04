/* Tests that a server tells another server's status message from its own and from other messages. */
#include "intake/other_server.h"

#include <string.h>

#include "trocar_status_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

enum { OWN = 5, OTHER = 6 };
static const int64_t SECOND = 1000000000;

static uint8_t bytes[2048];

static size_t status_of(int64_t server) {
    trocar_status_t m = {.server = server, .host = "lab, process 12", .scene = "/a/long/way/to/figure8.yaml", .inverse = "dense", .message = ""};
    int size = trocar_status_t_encode(bytes, 0, sizeof bytes, &m);
    assert_true(size > 0);
    return (size_t)size;
}

static void other_server_is_detected_and_named(void **unused) {
    (void)unused;
    other_server o = {0};
    other_server_hear(&o, OWN, bytes, status_of(OWN), SECOND);
    assert_false(other_server_present(&o, SECOND));
    other_server_hear(&o, OWN, bytes, status_of(OTHER), 2 * SECOND);
    assert_true(other_server_present(&o, 2 * SECOND));
    assert_int_equal(o.id, OTHER);
    assert_string_equal(o.host, "lab, process 12");
    assert_non_null(strstr(o.scene, "figure8.yaml"));
    other_server_hear(&o, OWN, bytes, status_of(OWN), 2 * SECOND + 1);
    assert_true(other_server_present(&o, 3 * SECOND - 1));
    assert_false(other_server_present(&o, 3 * SECOND));
}

/* The names in the message are written to the log, so they must be made harmless. */
static void names_are_printable(void **unused) {
    (void)unused;
    other_server o = {0};
    trocar_status_t m = {.server = OTHER, .host = "lab\033[31m\ntrocar-server: forged", .scene = "\007scene.yaml", .inverse = "", .message = ""};
    other_server_hear(&o, OWN, bytes, (size_t)trocar_status_t_encode(bytes, 0, sizeof bytes, &m), SECOND);
    assert_string_equal(o.host, "lab?[31m?trocar-server: forged");
    assert_string_equal(o.scene, "?scene.yaml");
}

static void invalid_status_messages_are_ignored(void **unused) {
    (void)unused;
    other_server o = {0};
    size_t size = status_of(OTHER);
    for (size_t length = 0; length < size; length++) other_server_hear(&o, OWN, bytes, length, SECOND);
    bytes[0] ^= 1; /* of another version */
    other_server_hear(&o, OWN, bytes, size, SECOND);
    assert_false(other_server_present(&o, SECOND));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(other_server_is_detected_and_named),
        cmocka_unit_test(names_are_printable),
        cmocka_unit_test(invalid_status_messages_are_ignored),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
