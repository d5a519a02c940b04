/* Shows the progress of long tasks on stderr. */
#ifndef TROCAR_PROGRESS_H
#define TROCAR_PROGRESS_H

/* Draws, on a terminal, a bar that is redrawn every percent; otherwise a line every 10 %. One task at a time, fractions 0 to 1. */
void progress_show(const char *what, double fraction, void *context);

#endif
