/* An output file that is either complete or absent: it is written under a temporary name and renamed at the end. */
#ifndef TROCAR_OUTPUT_H
#define TROCAR_OUTPUT_H

#include "base/error.h"

typedef struct {
    char path[1024], temporary[1040];
    FILE *file;              /* NULL when the file is not open */
} output;

/* Opens the temporary file. BAD_INPUT if it cannot be created. */
trocar_status output_open(output *o, const char *path, trocar_error *why);

/* Closes the file and gives it its final name. Returns SYSTEM, and leaves no file, if it could not be written completely. */
trocar_status output_commit(output *o, trocar_error *why);

/* Removes the temporary file. Does nothing if no file is open, for example after a commit. */
void output_abandon(output *o);

#endif
