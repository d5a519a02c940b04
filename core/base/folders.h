/* Creates folders. */
#ifndef TROCAR_FOLDERS_H
#define TROCAR_FOLDERS_H

#include <stdbool.h>

/* Creates a folder and its parents if they do not exist, like mkdir -p. On success, `path` is unchanged. On failure, errno says why, and `path` is cut off
   after the folder that could not be created. */
bool folders_create(char *path);

#endif
