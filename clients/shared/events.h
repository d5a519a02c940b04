/* A wrench's flags and events as text: the names of their constants in lcmtypes/trocar.lcm, in lower case. */
#ifndef TROCAR_EVENTS_H
#define TROCAR_EVENTS_H

#include <stdbool.h>
#include <stddef.h>

/* Writes the events separated by '|', such as "puncture:capsule|added", or "" if there are none. `membrane` is the name of the punctured membrane. Truncates
   the text to `size` bytes. */
void events_text(unsigned events, const char *membrane, char *text, size_t size);

/* Writes the flags separated by ", ", such as "stale, ramping", or "" if none is set. */
void flags_text(unsigned flags, char *text, size_t size);

/* Writes the name of the flag with this index, from 0. Returns false after the last flag. */
bool flag_at(int index, unsigned *bit, const char **word);

#endif
