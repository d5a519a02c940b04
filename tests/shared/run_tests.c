/* A program of several tests: runs the one that is named, a source file whose main is compiled under the file's name.
   usage: PROGRAM TEST [--only PATTERN | --except PATTERN]     without TEST: their names */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#define TEST(name) int name(void);
#include TESTS
#undef TEST

/* Of the cases in the test, runs those whose name matches a pattern with * and ?, or all but those. */
static int choose_cases(int count, char **given) {
    if (count == 0) return 0;
    if (count == 2 && strcmp(given[0], "--only") == 0) return cmocka_set_test_filter(given[1]), 0;
    if (count == 2 && strcmp(given[0], "--except") == 0) return cmocka_set_skip_filter(given[1]), 0;
    return 2;
}

int main(int count, char **given) {
    static const struct {
        const char *name;
        int (*run)(void);
    } tests[] = {
#define TEST(name) {#name, name},
#include TESTS
#undef TEST
    };
    for (size_t i = 0; i < sizeof tests / sizeof *tests; i++) {
        if (count < 2) puts(tests[i].name);
        else if (strcmp(given[1], tests[i].name) == 0) return choose_cases(count - 2, given + 2) ? 2 : tests[i].run();
    }
    if (count < 2) return 0;
    fprintf(stderr, "%s: no test %s\n", given[0], given[1]);
    return 2;
}
