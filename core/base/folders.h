/* Creation of folders. */
#ifndef TROCAR_FOLDERS_H
#define TROCAR_FOLDERS_H

#include <stdbool.h>

/* Creates a folder, and those that contain it, unless they exist. After a failure, errno has the reason, and `path` is the folder that could not be created;
   otherwise it is unchanged. */
bool folders_create(char *path);

#endif
