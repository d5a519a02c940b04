#define _POSIX_C_SOURCE 200809L
#include "base/input_file.h"

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* Opens the file first and then checks its type, so that it cannot be swapped in between. O_NONBLOCK: the path may refer to a FIFO. */
FILE *input_open(const char *path, const char **why) {
    struct stat status;
    int descriptor = open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC | O_NOCTTY);
    if (descriptor < 0 || fstat(descriptor, &status) != 0) *why = strerror(errno);
    else if (S_ISDIR(status.st_mode)) *why = strerror(EISDIR);
    else if (!S_ISREG(status.st_mode)) *why = "not a regular file";
    else {
        FILE *file = fdopen(descriptor, "rb");
        if (file) return file;
        *why = strerror(errno);
    }
    if (descriptor >= 0) close(descriptor);
    return NULL;
}
