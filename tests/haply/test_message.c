/* Tests messages of the Haply Inverse Service: choice of device and handle, events, and outgoing messages. Invalid messages are tested in test_haply.py. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "message.h"

#define DEVICE(id, x) "{\"device_id\":\"" id "\",\"state\":{\"cursor_position\":{\"x\":" x ",\"y\":0.1,\"z\":0.2}},\"status\":{\"calibrated\":true}}"
#define HANDLE(id, w, state) "{\"device_id\":\"" id "\",\"state\":{\"orientation\":{\"x\":0,\"y\":0,\"z\":0,\"w\":" w "}," state "}}"

static const haply_choice ANY = {.clutch = "a"};

static haply_state read_good(const char *text, const haply_choice *choice) {
    haply_state state;
    assert_int_equal(haply_read(text, strlen(text), choice, &state), HAPLY_GOOD);
    return state;
}

static void the_first_device_or_the_named_one(void **unused) {
    (void)unused;
    static const char text[] = "{\"inverse3\":[" DEVICE("04BA", "0.01") "," DEVICE("049D", "0.02") "]}";
    haply_state state = read_good(text, &ANY);
    assert_string_equal(state.device, "04BA");
    assert_true(state.position.x == 0.01 && state.position.y == 0.1 && state.position.z == 0.2 && !state.has_session_id);
    assert_true(read_good(text, &(haply_choice){.device = "049D", .clutch = "a"}).position.x == 0.02);
    assert_int_equal(haply_read(text, strlen(text), &(haply_choice){.device = "0000", .clutch = "a"}, &state), HAPLY_NO_DEVICE);
}

static void handles_of_three_kinds(void **unused) {
    (void)unused;
    static const char text[] = "{\"session_id\":7,\"inverse3\":[" DEVICE("04BA", "0.01") "],\"verse_grip\":[" HANDLE("61548", "1", "\"button\":true") "],"
                               "\"wireless_verse_grip\":[" HANDLE("1", "-1.01", "\"buttons\":{\"a\":false,\"b\":true}") "]}";
    haply_state state = read_good(text, &ANY);
    assert_string_equal(state.handle, "1");
    assert_true(state.orientation.w == -1 && !state.clutch && state.has_session_id);
    assert_true(read_good(text, &(haply_choice){.clutch = "b"}).clutch);
    state = read_good(text, &(haply_choice){.handle = "61548", .clutch = "a"});
    assert_string_equal(state.handle, "61548");
    assert_true(state.clutch); /* the handle's only button is the clutch, whatever its name */
    assert_string_equal(read_good(text, &(haply_choice){.handle = "2", .clutch = "a"}).handle, "");
}

static void a_handle_without_a_rotation_is_missing(void **unused) {
    (void)unused;
    static const char *const wrong[] = {"0", "0.5", "2", "1e300", "1e999", "\"1\"", "null"};
    for (int i = 0; i < 7; i++) {
        char text[1024];
        snprintf(text, sizeof text, "{\"inverse3\":[" DEVICE("04BA", "0.01") "],\"wireless_verse_grip\":[" HANDLE("1", "%s", "\"button\":true") "]}", wrong[i]);
        haply_state state = read_good(text, &ANY);
        assert_string_equal(state.handle, "");
        assert_false(state.clutch);
    }
}

/* The messages are those documented on the pages service/realtime/control-commands and service/tutorials/01. */
static void forces_are_written(void **unused) {
    (void)unused;
    char text[512];
    size_t length = haply_write_force(text, sizeof text, "049D", "vector", v3(0, -1.5, 0.2000009), false);
    assert_string_equal(text, "{\"inverse3\":[{\"device_id\":\"049D\",\"commands\":{\"set_cursor_force\":{\"vector\":{\"x\":0.000000,\"y\":-1.500000,\"z\":0.200000}}}}]}");
    assert_int_equal(length, strlen(text));
    haply_write_force(text, sizeof text, "049D", "values", v3(0, 0, 0), true);
    assert_non_null(strstr(text, "{\"session\":{\"configure\":{\"profile\":{\"name\":"));
    assert_non_null(strstr(text, "\"values\":{"));
}

static void events_are_told_from_warnings_on(void **unused) {
    (void)unused;
    char told[64];
    static const char warning[] = "{\"name\":\"device-safety-triggered\",\"category\":\"device\",\"level\":\"warning\",\"data\":{},\"message\":\"guard\\u001b[31m\\n\"}";
    assert_true(haply_read_event(warning, sizeof warning - 1, told, sizeof told));
    assert_string_equal(told, "warning: device-safety-triggered: guard?[31m?");
    static const char *const quiet[] = {"{\"level\":\"info\",\"name\":\"x\"}", "{\"level\":3}", "[]", "", "{", "null"};
    for (int i = 0; i < 6; i++) assert_false(haply_read_event(quiet[i], strlen(quiet[i]), told, sizeof told));
    assert_true(haply_read_event("{\"level\":\"panic\"}", 17, told, sizeof told));
    assert_string_equal(told, "panic: no name: ");
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_first_device_or_the_named_one), cmocka_unit_test(handles_of_three_kinds),
        cmocka_unit_test(a_handle_without_a_rotation_is_missing), cmocka_unit_test(forces_are_written),
        cmocka_unit_test(events_are_told_from_warnings_on),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
