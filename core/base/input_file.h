/* Opens files whose names are given by the user. */
#ifndef TROCAR_INPUT_FILE_H
#define TROCAR_INPUT_FILE_H

#include <stdio.h>

/* Opens a regular file for reading, or returns NULL and the reason in *why. Other kinds of files are rejected: opening a FIFO would block until a writer opens
   it. */
FILE *input_open(const char *path, const char **why);

#endif
