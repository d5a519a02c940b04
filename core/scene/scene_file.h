/* Reads the files of a scene. */
#ifndef TROCAR_SCENE_FILE_H
#define TROCAR_SCENE_FILE_H

#include "base/error.h"

/* Reads a file into *text, which the caller frees on success. `kind` says in messages what the file is. BAD_INPUT if the file cannot be read or is larger than
   1 MiB. */
trocar_status scene_file_read(const char *path, const char *kind, char **text, size_t *length, trocar_error *why);

#endif
