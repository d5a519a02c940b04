/* Shows the progress of long tasks on stderr. */
#ifndef TROCAR_PROGRESS_H
#define TROCAR_PROGRESS_H

/* Draws a bar on a terminal, redrawn at every percent; prints a line every 10 % to a file or pipe. For one task at a time, with fractions from 0 to
   1. */
void progress_show(const char *what, double fraction, void *context);

#endif
