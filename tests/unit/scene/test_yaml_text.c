/* Tests the line numbers of keys. */
#include "yaml/yaml_text.h" /* before cmocka.h, whose macro hides `fail` */

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

static const char TEXT[] =
    "# line 1\n"
    "first: 1\n"
    "list:\n"
    "  - name: a\n"
    "    inner: {x: 1,\n"
    "            y: 2}\n"
    "\n"
    "  - name: b\n"
    "names: [p,\n"
    "        q]\n";

static void values_are_found_by_their_paths(void **state) {
    (void)state;
    static const struct { const char *path; int line; } cases[] = {
        {"first", 2}, {"list", 3}, {"list[0]", 4}, {"list[0].name", 4}, {"list[0].inner.x", 5}, {"list[0].inner.y", 6},
        {"list[1].name", 8}, {"names", 9}, {"names[0]", 9}, {"names[1]", 10}, {"", 2}};
    yaml_text lines;
    trocar_error why;
    assert_int_equal(yaml_open("t", TEXT, sizeof TEXT - 1, &lines, &why), TROCAR_OK);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        assert_int_equal(yaml_line(&lines, cases[i].path), cases[i].line);
    yaml_close(&lines);
}

static void incomplete_path_gives_its_parent(void **state) {
    (void)state;
    static const struct { const char *path; int line; } cases[] = {
        {"list[1].inner.x", 8}, {"list[7].name", 3}, {"lost", 2}, {"first.x", 2}, {"first[0]", 2}, {"list[-1]", 3}, {"list.x", 3}};
    yaml_text lines;
    trocar_error why;
    assert_int_equal(yaml_open("t", TEXT, sizeof TEXT - 1, &lines, &why), TROCAR_OK);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        assert_int_equal(yaml_line(&lines, cases[i].path), cases[i].line);
    yaml_close(&lines);
}

static void assert_refused(const char *text, const char *words) {
    yaml_text lines;
    trocar_error why = {""};
    assert_int_equal(yaml_open("scene.yaml", text, strlen(text), &lines, &why), TROCAR_BAD_INPUT);
    if (!strstr(why.text, words)) fail_msg("\"%s\" lacks \"%s\"", why.text, words);
}

static void invalid_yaml_is_refused_with_its_line(void **state) {
    (void)state;
    assert_refused("", "scene.yaml: empty");
    assert_refused("# only a comment\n", "scene.yaml: empty");
    assert_refused("a: 1\nb: {c: 2\n\nd: 3\n", "scene.yaml:4: not valid YAML");
    assert_refused("a: 1\n\tb: 2\n", "scene.yaml:2: not valid YAML");
    assert_refused("a: *lost\n", "scene.yaml:1: not valid YAML");
    assert_refused("a: 1\nb: \xff\xfe\n", "scene.yaml:2: not valid YAML");
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(values_are_found_by_their_paths),
        cmocka_unit_test(incomplete_path_gives_its_parent),
        cmocka_unit_test(invalid_yaml_is_refused_with_its_line),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
