#include "shared/output.h"

#include <errno.h>
#include <stdbool.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* True for devices and pipes, such as /dev/null. They are written in place, because renaming a file to their path would replace them. */
static bool is_special(const char *path) {
    struct stat status;
    return stat(path, &status) == 0 && !S_ISREG(status.st_mode) && !S_ISDIR(status.st_mode);
}

trocar_status output_open(output *o, const char *path, trocar_error *why) {
    *o = (output){0};
    if (strlen(path) >= sizeof o->path) return fail(why, TROCAR_BAD_INPUT, "%s: path too long", path);
    strcpy(o->path, path);
    if (is_special(path)) o->file = fopen(path, "w");
    else {
        snprintf(o->temporary, sizeof o->temporary, "%s.part", path);
        o->file = fopen(o->temporary, "w");
    }
    return o->file ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "%s: cannot be written: %s", path, strerror(errno));
}

trocar_status output_commit(output *o, trocar_error *why) {
    if (!o->file) return TROCAR_OK;
    bool failed = ferror(o->file) != 0;
    failed |= fclose(o->file) != 0;
    o->file = NULL;
    if (!failed && (!*o->temporary || rename(o->temporary, o->path) == 0)) return TROCAR_OK;
    trocar_status status = fail(why, TROCAR_SYSTEM, "%s: cannot be written: %s", o->path, strerror(errno));
    if (*o->temporary) unlink(o->temporary);
    return status;
}

void output_abandon(output *o) {
    if (!o->file) return;
    fclose(o->file);
    o->file = NULL;
    if (*o->temporary) unlink(o->temporary);
}
