/* Creates and removes folders. */
#ifndef TROCAR_FOLDERS_H
#define TROCAR_FOLDERS_H

#include <stdbool.h>
#include <stddef.h>

/* Creates a folder and its parents if they do not exist, like mkdir -p. On success, `path` is unchanged. On failure, errno says why, and `path` is cut off
   after the folder that could not be created. */
bool folders_create(char *path);

/* Creates a folder NAME-XXXXXX with a unique name in $TMPDIR, by default /tmp, and writes its path. On failure, errno says why, and `path` is empty. */
bool folders_create_temporary(const char *name, char *path, size_t size);

/* Removes a folder with everything in it. Does not follow links. */
void folders_remove(const char *path);

#endif
