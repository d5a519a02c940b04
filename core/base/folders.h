/* Creation of folders. */
#ifndef TROCAR_FOLDERS_H
#define TROCAR_FOLDERS_H

#include <stdbool.h>

/* Creates a folder and its parents, unless they exist. On success, `path` is unchanged. On failure, errno has the reason, and `path` is cut off after the
   folder that could not be created. */
bool folders_create(char *path);

#endif
