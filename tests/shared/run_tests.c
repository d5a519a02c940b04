/* The main function of a program with several tests, of which it runs one. Each test is a source file whose main function is renamed to the file's name.
   usage:
   PROGRAM TEST [--only CASES | --except CASES] TEST may be left out if the program has only one. CASES: names of the file's test cases, as patterns with *
   and ?, separated by commas. Without arguments, a program with several tests prints their names. */
#include <fnmatch.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define TEST(name) int name(void);
#include TESTS
#undef TEST

static const struct {
    const char *name;
    int (*run)(void);
} programs_tests[] = {
#define TEST(name) {#name, name},
#include TESTS
#undef TEST
};
enum { TESTS_COUNT = sizeof programs_tests / sizeof *programs_tests, MOST_PATTERNS = 32 };

static char *patterns[MOST_PATTERNS];
static int pattern_count;
static bool except; /* if set, runs all cases except those that match */

static bool fits(const char *name, bool *used) {
    bool any = false;
    for (int i = 0; i < pattern_count; i++)
        if (fnmatch(patterns[i], name, 0) == 0) any = used[i] = true;
    return any;
}

/* The linker puts this function in place of cmocka's, whose filter accepts only a single pattern. */
int __real__cmocka_run_group_tests(const char *group, const struct CMUnitTest *cases, size_t count, CMFixtureFunction setup, CMFixtureFunction teardown);
int __wrap__cmocka_run_group_tests(const char *group, const struct CMUnitTest *cases, size_t count, CMFixtureFunction setup, CMFixtureFunction teardown);
int __wrap__cmocka_run_group_tests(const char *group, const struct CMUnitTest *cases, size_t count, CMFixtureFunction setup, CMFixtureFunction teardown) {
    struct CMUnitTest *chosen = calloc(count, sizeof *chosen);
    size_t chosen_count = 0;
    bool used[MOST_PATTERNS] = {false};
    if (chosen == NULL) return 1;
    for (size_t i = 0; i < count; i++)
        if (pattern_count == 0 || fits(cases[i].name, used) != except) chosen[chosen_count++] = cases[i];
    for (int i = 0; i < pattern_count; i++)
        if (!used[i]) printf("no case is named %s\n", patterns[i]);
    int failed = __real__cmocka_run_group_tests(group, chosen, chosen_count, setup, teardown);
    free(chosen);
    return failed;
}

static int usage(const char *program) {
    fprintf(stderr, "usage: %s TEST [--only CASES | --except CASES]\n", program);
    return 2;
}

int main(int count, char **given) {
    const char *program = *given++, *name = TESTS_COUNT == 1 ? programs_tests[0].name : NULL;
    count--;
    if (count > 0 && strncmp(given[0], "--", 2) != 0) name = *given++, count--;
    if (name == NULL) {
        for (int i = 0; i < TESTS_COUNT; i++) puts(programs_tests[i].name);
        return count > 0 ? usage(program) : 0;
    }
    if (count > 0) {
        except = strcmp(given[0], "--except") == 0;
        if (count != 2 || (!except && strcmp(given[0], "--only") != 0)) return usage(program);
        for (char *pattern = strtok(given[1], ","); pattern && pattern_count < MOST_PATTERNS; pattern = strtok(NULL, ",")) patterns[pattern_count++] = pattern;
    }
    for (int i = 0; i < TESTS_COUNT; i++)
        if (strcmp(name, programs_tests[i].name) == 0) return programs_tests[i].run();
    fprintf(stderr, "%s: no test %s\n", program, name);
    return 2;
}
