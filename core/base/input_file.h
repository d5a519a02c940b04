/* Opens files named by the user. */
#ifndef TROCAR_INPUT_FILE_H
#define TROCAR_INPUT_FILE_H

#include <stdio.h>

/* Opens a regular file for reading. On failure, returns NULL and sets *why to the reason. Files that are not regular are rejected, because opening a FIFO
   would block until a writer opens it. */
FILE *input_open(const char *path, const char **why);

#endif
