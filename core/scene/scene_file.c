#include "scene/scene_file.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "base/input_file.h"

enum { MAX_FILE = 1 << 20 }; /* bytes, maximum file size; scenes typically have a few thousand bytes */

trocar_status scene_file_read(const char *path, const char *kind, char **text, size_t *length, trocar_error *why) {
    const char *reason;
    FILE *file = input_open(path, &reason);
    if (!file) return fail(why, TROCAR_BAD_INPUT, "%s: cannot open the %s: %s", path, kind, reason);
    trocar_status status = TROCAR_OK;
    *text = malloc(MAX_FILE);
    *length = *text ? fread(*text, 1, MAX_FILE, file) : 0;
    if (!*text) status = fail(why, TROCAR_NO_MEMORY, "%s: no memory to read it", path);
    else if (ferror(file)) status = fail(why, TROCAR_BAD_INPUT, "%s: cannot read the %s: %s", path, kind, strerror(errno));
    else if (*length == MAX_FILE) status = fail(why, TROCAR_BAD_INPUT, "%s: too long for a %s file", path, kind);
    fclose(file);
    if (status != TROCAR_OK) free(*text);
    return status;
}
