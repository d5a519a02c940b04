#include "shared/output.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <cmocka.h>

static char folder[] = "/tmp/trocar-test-output-XXXXXX", path[64];

static int make_folder(void **state) {
    (void)state;
    if (!mkdtemp(folder)) return -1;
    snprintf(path, sizeof path, "%s/result", folder);
    return 0;
}

static int remove_folder(void **state) {
    (void)state;
    return rmdir(folder);   /* rmdir fails if a file is left in the folder */
}

static void appears_when_committed(void **state) {
    (void)state;
    trocar_error why;
    output o;
    assert_int_equal(output_open(&o, path, &why), TROCAR_OK);
    fprintf(o.file, "whole");
    assert_int_not_equal(access(path, F_OK), 0);
    assert_int_equal(output_commit(&o, &why), TROCAR_OK);
    output_abandon(&o);
    char text[16] = "";
    FILE *file = fopen(path, "r");
    assert_non_null(fgets(text, sizeof text, file));
    fclose(file);
    assert_string_equal(text, "whole");
    unlink(path);
}

static void leaves_nothing_when_abandoned(void **state) {
    (void)state;
    trocar_error why;
    output o;
    assert_int_equal(output_open(&o, path, &why), TROCAR_OK);
    output_abandon(&o);
    assert_int_not_equal(access(path, F_OK), 0);
    assert_int_not_equal(access(o.temporary, F_OK), 0);
}

/* Run as root with --csv /dev/null, renaming a temporary file would replace the device with a regular file. */
static void special_files_are_written_in_place(void **state) {
    (void)state;
    trocar_error why;
    output o;
    assert_int_equal(mkfifo(path, 0600), 0);
    int reader = open(path, O_RDONLY | O_NONBLOCK);
    assert_true(reader >= 0);
    assert_int_equal(output_open(&o, path, &why), TROCAR_OK);
    fprintf(o.file, "whole");
    assert_int_equal(output_commit(&o, &why), TROCAR_OK);
    char text[16] = "";
    assert_int_equal(read(reader, text, sizeof text - 1), 5);
    close(reader);
    assert_string_equal(text, "whole");
    assert_int_equal(output_open(&o, "/dev/null", &why), TROCAR_OK);
    output_abandon(&o);
    assert_int_equal(access("/dev/null", W_OK), 0);
    struct stat status;
    assert_int_equal(stat(path, &status), 0);
    assert_true(S_ISFIFO(status.st_mode));
    unlink(path);
}

static void full_disk_is_reported(void **state) {
    (void)state;
    trocar_error why;
    output o = {.path = "/dev/full", .temporary = "/nowhere/x", .file = fopen("/dev/full", "w")};
    fprintf(o.file, "more than fits");
    assert_int_equal(output_commit(&o, &why), TROCAR_SYSTEM);
    assert_non_null(strstr(why.text, "/dev/full"));
}

static void unwritable_path_is_refused(void **state) {
    (void)state;
    trocar_error why;
    output o;
    assert_int_equal(output_open(&o, "/nowhere/x.csv", &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "/nowhere/x.csv"));
    output_abandon(&o);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(appears_when_committed),
        cmocka_unit_test(leaves_nothing_when_abandoned),
        cmocka_unit_test(special_files_are_written_in_place),
        cmocka_unit_test(full_disk_is_reported),
        cmocka_unit_test(unwritable_path_is_refused),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
