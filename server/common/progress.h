/* Shows the progress and the messages of long calls on stderr. */
#ifndef TROCAR_PROGRESS_H
#define TROCAR_PROGRESS_H

#include <stdint.h>

/* Draws a bar on a terminal, redrawn at every percent; prints a line every 10 % to a file or pipe. For one task at a time, with fractions from 0 to
   1. */
void progress_show(const char *what, double fraction, void *context);

/* For trocar_log.write, with the program's name as `context`. progress_log prints every message, progress_warn only warnings, which begin with the name. */
void progress_log(int32_t level, const char *message, void *context);
void progress_warn(int32_t level, const char *message, void *context);

#endif
