/* Shows the progress and the messages of long function calls on stderr. */
#ifndef TROCAR_PROGRESS_H
#define TROCAR_PROGRESS_H

#include <stdint.h>

/* On a terminal, draws a bar and redraws it at every percent; to a file or pipe, prints a line at every 10 %. For one task at a time, whose progress
   runs from 0 to 1. */
void progress_show(const char *what, double fraction, void *context);

/* Callbacks for trocar_log.write, whose `context` is the program's name. progress_log prints every message; progress_warn prints only warnings, with
   the program's name in front. */
void progress_log(int32_t level, const char *message, void *context);
void progress_warn(int32_t level, const char *message, void *context);

#endif
