/* If stderr is not a terminal, progress is a line per tenth, without repetition. */
#include "common/progress.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>

static void file_gets_one_line_per_tenth(void **state) {
    (void)state;
    char text[512] = "";
    FILE *file = tmpfile();
    int before = dup(STDERR_FILENO);
    assert_true(dup2(fileno(file), STDERR_FILENO) >= 0);
    for (int i = 0; i <= 1000; i++) progress_show("first", i / 1000.0 * 0.35, NULL);
    for (int i = 0; i <= 2; i++) progress_show("second", i / 2.0, NULL);
    fflush(stderr);
    dup2(before, STDERR_FILENO);
    rewind(file);
    text[fread(text, 1, sizeof text - 1, file)] = '\0';
    assert_string_equal(text, "first: 0 %\nfirst: 10 %\nfirst: 20 %\nfirst: 30 %\nsecond: 0 %\nsecond: 50 %\nsecond: 100 %\n");
    fclose(file);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(file_gets_one_line_per_tenth)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
