/* Tests that the cache directory of condensed inverses stays within its size limit. The contents of the files are tested in test_inverse_condensed.c. */
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "condensed/condensed_cache.h"

#include <cmocka.h>

static char directory[] = "/tmp/test_cache.XXXXXX";

enum { FILES = 5, BYTES = 1000 };
/* Files, with the times (s) at which they were last used. One was written by an earlier version, one is unfinished, and one belongs to another program. */
static const struct { const char *name; long used; } files[FILES] = {
    {"condensed-00000000000000aa.inverse", 300}, {"condensed-00000000000000bb.h5", 100}, {"condensed-00000000000000cc.inverse", 200},
    {"condensed-00000000000000dd.inverse.123", 150}, {"condensed-milk.inverse", 1}};

static void path_of(int file, char path[200]) { snprintf(path, 200, "%s/%s", directory, files[file].name); }

static void put_files(void) {
    static const char nothing[BYTES];
    for (int i = 0; i < FILES; i++) {
        char path[200];
        path_of(i, path);
        FILE *file = fopen(path, "wb");
        assert_non_null(file);
        assert_int_equal(fwrite(nothing, 1, BYTES, file), BYTES);
        fclose(file);
        struct timespec times[2] = {{files[i].used, 0}, {files[i].used, 0}};
        assert_int_equal(utimensat(AT_FDCWD, path, times, 0), 0);
    }
}

static void least_recently_used_files_are_removed_first(void **state) {
    (void)state;
    static const struct { int kept; double bytes; bool there[FILES]; } cases[] = {
        {0, 4000, {1, 1, 1, 1, 1}}, {0, 3999, {1, 0, 1, 1, 1}}, {0, 2000, {1, 0, 1, 0, 1}}, {0, 1999, {1, 0, 0, 0, 1}},
        {0, 0, {1, 0, 0, 0, 1}}, {1, 2000, {1, 1, 0, 0, 1}}, {1, 0, {0, 1, 0, 0, 1}},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        condensed_cache kept = {.key = 0};
        char path[200];
        put_files();
        path_of(cases[i].kept, path);
        strcpy(kept.path, path);
        condensed_cache_trim(&kept, cases[i].bytes);
        for (int k = 0; k < FILES; k++) {
            path_of(k, path);
            assert_int_equal(access(path, F_OK) == 0, cases[i].there[k]);
        }
    }
}

/* A process in another container may have the same process id and be writing the same inverse at the same time. */
static void another_writers_file_is_left_alone(void **state) {
    (void)state;
    double numbers[9] = {2, 0, 0, 0, 2, 0, 0, 0, 2};
    symmetric_blocks matrix = {.count = 1, .numbers = numbers}, mapped = {.count = 1};
    condensed_cache cache = {.key = 7};
    char other[1300];
    int order = 5, found = -1;
    file_mapping mapping = {0};
    trocar_error why;
    struct stat s;
    snprintf(cache.path, sizeof cache.path, "%s/condensed-0000000000000007.inverse", directory);
    snprintf(other, sizeof other, "%s.%ld", cache.path, (long)getpid());
    FILE *file = fopen(other, "wb");
    assert_non_null(file);
    assert_int_equal(fwrite("half", 1, 4, file), 4);
    fclose(file);
    assert_int_equal(condensed_cache_write(&cache, &order, &matrix, &why), TROCAR_OK);
    assert_int_equal(stat(other, &s), 0);
    assert_int_equal(s.st_size, 4);
    assert_int_equal(condensed_cache_map(&cache, &found, &mapped, &mapping), CACHE_READ);
    assert_int_equal(found, 5);
    munmap(mapping.at, mapping.bytes);
    assert_int_equal(unlink(other), 0);
    assert_int_equal(unlink(cache.path), 0); /* the file was written */
}

static void room_is_checked_beforehand(void **state) {
    (void)state;
    condensed_cache cache = {.key = 7};
    trocar_error why = {""};
    symmetric_blocks small = {.count = 1}, huge = {.count = 20000000};
    snprintf(cache.path, sizeof cache.path, "%s/condensed-0000000000000007.inverse", directory);
    assert_int_equal(condensed_cache_check(&cache, &small, &why), TROCAR_OK);
    assert_int_equal(condensed_cache_check(&cache, &huge, &why), TROCAR_SYSTEM); /* 14 PB */
    assert_non_null(strstr(why.text, "there is room for"));
    strcpy(cache.path, "/proc/nowhere/condensed-0000000000000007.inverse");
    assert_int_equal(condensed_cache_check(&cache, &small, &why), TROCAR_SYSTEM);
    assert_non_null(strstr(why.text, "cannot be written"));
}

/* Unfinished files older than an hour are removed, whatever inverse they belong to. No other files are. */
static void old_halves_are_removed(void **state) {
    (void)state;
    static const struct { const char *name; long age; bool there; } left[] = {
        {"condensed-0000000000000007.inverse.00112233445566aa", 7200, false}, {"condensed-0000000000000008.inverse.00112233445566aa", 7200, false},
        {"condensed-0000000000000007.inverse.00112233445566bb", 60, true}, {"condensed-0000000000000009.inverse", 7200, true}};
    enum { LEFT = sizeof left / sizeof *left };
    double numbers[9] = {2, 0, 0, 0, 2, 0, 0, 0, 2};
    symmetric_blocks matrix = {.count = 1, .numbers = numbers};
    condensed_cache cache = {.key = 7};
    char path[200];
    int order = 5;
    trocar_error why;
    for (int i = 0; i < LEFT; i++) {
        snprintf(path, sizeof path, "%s/%s", directory, left[i].name);
        FILE *file = fopen(path, "wb");
        assert_non_null(file);
        fclose(file);
        struct timespec then = {time(NULL) - left[i].age, 0};
        assert_int_equal(utimensat(AT_FDCWD, path, (struct timespec[2]){then, then}, 0), 0);
    }
    snprintf(cache.path, sizeof cache.path, "%s/condensed-0000000000000007.inverse", directory);
    assert_int_equal(condensed_cache_write(&cache, &order, &matrix, &why), TROCAR_OK);
    for (int i = 0; i < LEFT; i++) {
        snprintf(path, sizeof path, "%s/%s", directory, left[i].name);
        assert_int_equal(unlink(path) == 0, left[i].there);
    }
    assert_int_equal(unlink(cache.path), 0);
}

static int create(void **state) {
    (void)state;
    return mkdtemp(directory) ? 0 : -1;
}

static int destroy(void **state) {
    (void)state;
    for (int i = 0; i < FILES; i++) {
        char path[200];
        path_of(i, path);
        unlink(path);
    }
    return rmdir(directory);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(least_recently_used_files_are_removed_first), cmocka_unit_test(another_writers_file_is_left_alone),
                                       cmocka_unit_test(room_is_checked_beforehand), cmocka_unit_test(old_halves_are_removed)};
    return cmocka_run_group_tests(tests, create, destroy);
}
