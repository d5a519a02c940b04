/* Opens files named by the user. */
#ifndef TROCAR_INPUT_FILE_H
#define TROCAR_INPUT_FILE_H

#include <stdio.h>

/* Opens a regular file for reading. On failure, returns NULL and sets *why to the reason. Other files are rejected: a FIFO, for example, would block until
   someone writes to it. */
FILE *input_open(const char *path, const char **why);

#endif
