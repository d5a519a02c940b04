#define _GNU_SOURCE
#include "base/folders.h"

#include <errno.h>
#include <ftw.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

bool folders_create(char *path) {
    for (char *end = path; *end;) {
        end += 1 + strcspn(end + 1, "/");
        char next = *end;
        *end = '\0';
        if (mkdir(path, 0777) != 0 && errno != EEXIST) return false;
        *end = next;
    }
    return true;
}

bool folders_create_temporary(const char *name, char *path, size_t size) {
    const char *parent = getenv("TMPDIR");
    int length = snprintf(path, size, "%s/%s-XXXXXX", parent && *parent ? parent : "/tmp", name);
    if (length >= 0 && (size_t)length < size && mkdtemp(path)) return true;
    if ((size_t)length >= size) errno = ENAMETOOLONG;
    path[0] = '\0';
    return false;
}

static int remove_entry(const char *path, const struct stat *status, int type, struct FTW *place) {
    (void)status, (void)type, (void)place;
    return remove(path);
}

void folders_remove(const char *path) { nftw(path, remove_entry, 16, FTW_DEPTH | FTW_PHYS); }
