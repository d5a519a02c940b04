/* Opens files that a user names. */
#ifndef TROCAR_INPUT_FILE_H
#define TROCAR_INPUT_FILE_H

#include <stdio.h>

/* Opens a regular file to read, or returns NULL and the reason in *why. Anything else is refused: opening a FIFO would wait until somebody writes to
   it, for ever. */
FILE *input_open(const char *path, const char **why);

#endif
