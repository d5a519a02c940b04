/* Tests that trocar-server --condense creates the file, finds it at the next start, and refuses scenes whose inverse is not condensed. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "condense.h"

#include <cmocka.h>

static char folder[] = "/tmp/test_condense.XXXXXX";
static char scene[64], cache[64];

static int create(void **state) {
    (void)state;
    if (!mkdtemp(folder)) return -1;
    snprintf(scene, sizeof scene, "%s/scene.yaml", folder);
    snprintf(cache, sizeof cache, "%s/cache", folder);
    return 0;
}

static int destroy(void **state) {
    (void)state;
    char command[128];
    snprintf(command, sizeof command, "rm -r %s", folder);
    return system(command);
}

/* Writes a scene with figure 8's mesh and these keys. */
static void write_scene(const char *keys) {
    FILE *from = fopen(MESHES "/figure8.yaml", "r"), *to = fopen(scene, "w");
    char line[512];
    assert_non_null(from);
    assert_non_null(to);
    while (fgets(line, sizeof line, from)) {
        if (strncmp(line, "mesh:", 5) == 0) fputs("mesh: " MESHES "/prostate-570.msh\n", to);
        else fputs(line, to);
    }
    fprintf(to, "%s\ncache: %s\n", keys, cache);
    fclose(from);
    fclose(to);
}

static char text[2048];
static trocar_status run(trocar_error *why) {
    FILE *out = fmemopen(text, sizeof text, "w");
    trocar_status status = condense_scene(scene, out, why);
    fclose(out);
    return status;
}

static const char condensed[] = "inverse: condensed\nregion_of_interest: {corridor: {from: [0, 0, 0], to: [0, 0, 0.1], radius: 0.02}}";

static void is_made_once(void **state) {
    (void)state;
    trocar_error why = {""};
    write_scene(condensed);
    assert_int_equal(run(&why), TROCAR_OK);
    assert_non_null(strstr(text, "written to"));
    assert_int_equal(run(&why), TROCAR_OK);
    assert_non_null(strstr(text, "read from"));
}

static void other_inverses_are_refused(void **state) {
    (void)state;
    trocar_error why = {""};
    write_scene("inverse: dense");
    assert_int_equal(run(&why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "dense"));
    assert_non_null(strstr(why.text, "region_of_interest"));
}

static void unwritable_file_is_an_error(void **state) {
    (void)state;
    trocar_error why = {""};
    snprintf(cache, sizeof cache, "/proc/nowhere");
    write_scene(condensed);
    assert_int_equal(run(&why), TROCAR_SYSTEM);
    assert_non_null(strstr(why.text, "cannot be written"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(is_made_once),
        cmocka_unit_test(other_inverses_are_refused),
        cmocka_unit_test(unwritable_file_is_an_error),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
