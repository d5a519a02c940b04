/* Opens files whose names are given by the user. */
#ifndef TROCAR_INPUT_FILE_H
#define TROCAR_INPUT_FILE_H

#include <stdio.h>

/* Opens a regular file for reading, or returns NULL and the reason in *why. Other types of files are rejected, because opening a FIFO would block until a
   writer opens it. */
FILE *input_open(const char *path, const char **why);

#endif
