#include "base/folders.h"

#include <errno.h>
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
