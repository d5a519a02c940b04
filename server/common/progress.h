/* Shows on stderr what a long-running call is doing. */
#ifndef TROCAR_PROGRESS_H
#define TROCAR_PROGRESS_H

#include <stdint.h>

/* Shows progress from 0 to 1. On a terminal, draws a bar and updates it at every percent; otherwise prints a line at every 10 %. Only one task can be shown at
   a time. */
void progress_show(const char *what, double fraction, void *context);

/* Callbacks for trocar_log.write. `context` is the program's name. progress_log prints every message; progress_warn prints only warnings, preceded by the
   program's name. */
void progress_log(int32_t level, const char *message, void *context);
void progress_warn(int32_t level, const char *message, void *context);

#endif
