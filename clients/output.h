/* A file that is either complete or absent: written under a temporary name and renamed when done. */
#ifndef TROCAR_OUTPUT_H
#define TROCAR_OUTPUT_H

#include "base/report.h"

typedef struct {
    char path[1024], temporary[1040];
    FILE *file;              /* NULL when not open */
} output;

/* Opens the temporary file; BAD_INPUT when it cannot be written there. */
trocar_status output_open(output *o, const char *path, report *why);

/* Closes and renames it; SYSTEM (and no file) when it could not be written completely. */
trocar_status output_commit(output *o, report *why);

/* Removes what was written; harmless after a commit or without an open. */
void output_abandon(output *o);

#endif
