/* Opens files that a user names. */
#ifndef TROCAR_INPUT_FILE_H
#define TROCAR_INPUT_FILE_H

#include <stdio.h>

/* Opens a regular file for reading, or returns NULL and the reason in *why. Other kinds of files are refused: opening a FIFO would block until
   somebody writes to it. */
FILE *input_open(const char *path, const char **why);

#endif
