/* Shared by all fuzzers: the entry point that libFuzzer calls, and in-memory files for parsers that need a path. */
#ifndef TROCAR_TESTS_FUZZ_H
#define TROCAR_TESTS_FUZZ_H

#define _GNU_SOURCE
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* Requires a condition that must hold for every input. */
#define REQUIRE(condition) ((condition) ? (void)0 : (fprintf(stderr, "%s:%d: not so: %s\n", __FILE__, __LINE__, #condition), abort()))

/* Returns the path of an in-memory file with these bytes, valid until the next call. */
static inline const char *file_of(const void *data, size_t size) {
    static char path[32];
    static int file = -1;
    if (file < 0) file = memfd_create("input", 0);
    REQUIRE(ftruncate(file, 0) == 0 && pwrite(file, data, size, 0) == (ssize_t)size);
    snprintf(path, sizeof path, "/proc/self/fd/%d", file);
    return path;
}

#endif
