/* A file that is either complete or not there: written beside its place, renamed when done. */
#ifndef TROCAR_OUTPUT_H
#define TROCAR_OUTPUT_H

#include "base/report.h"

typedef struct {
    char path[1024], temporary[1040];
    FILE *file;              /* NULL when not open */
} output;

/* Opens the temporary file; BAD_INPUT when the place cannot be written. */
trocar_status output_open(output *o, const char *path, report *why);

/* Closes it and puts it in place; SYSTEM (and no file) when the disk did not take all of it. */
trocar_status output_commit(output *o, report *why);

/* Removes what was written; harmless after a commit or without an open. */
void output_abandon(output *o);

#endif
