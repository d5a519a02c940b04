/* Tests what is written to a stderr that is not a terminal: messages, and one line per tenth of the progress, without repeats. */
#include "common/progress.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>

#include "trocar.h"

/* Returns what `show` writes to stderr. */
static const char *shown_by(void (*show)(void)) {
    static char text[512];
    FILE *file = tmpfile();
    int before = dup(STDERR_FILENO);
    assert_true(dup2(fileno(file), STDERR_FILENO) >= 0);
    show();
    fflush(stderr);
    dup2(before, STDERR_FILENO);
    rewind(file);
    text[fread(text, 1, sizeof text - 1, file)] = '\0';
    fclose(file);
    return text;
}

static void two_tasks(void) {
    for (int i = 0; i <= 1000; i++) progress_show("first", i / 1000.0 * 0.35, NULL);
    for (int i = 0; i <= 2; i++) progress_show("second", i / 2.0, NULL);
}

static void file_gets_one_line_per_tenth(void **state) {
    (void)state;
    assert_string_equal(shown_by(two_tasks), "first: 0 %\nfirst: 10 %\nfirst: 20 %\nfirst: 30 %\nsecond: 0 %\nsecond: 50 %\nsecond: 100 %\n");
}

static void all_messages(void) {
    progress_log(TROCAR_LOG_INFO, "inverse: dense", "program");
    progress_log(TROCAR_LOG_WARNING, "100 % of it", "program");
}

static void warnings_alone(void) {
    progress_warn(TROCAR_LOG_INFO, "inverse: dense", "program");
    progress_warn(TROCAR_LOG_WARNING, "mesh", "program");
}

static void warnings_name_the_program(void **state) {
    (void)state;
    assert_string_equal(shown_by(all_messages), "inverse: dense\nprogram: warning: 100 % of it\n");
    assert_string_equal(shown_by(warnings_alone), "program: warning: mesh\n");
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(file_gets_one_line_per_tenth), cmocka_unit_test(warnings_name_the_program)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
