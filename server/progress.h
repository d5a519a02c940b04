/* How far something that takes long has come, on stderr. */
#ifndef TROCAR_PROGRESS_H
#define TROCAR_PROGRESS_H

/* A bar that is redrawn each percent on a terminal, else a line each tenth. One task after the other, fractions 0 to 1. */
void progress_show(const char *what, double fraction, void *context);

#endif
