/* Flags and events of a wrench as text: the names of their constants in lcmtypes/trocar.lcm, in lower case. */
#ifndef TROCAR_EVENTS_H
#define TROCAR_EVENTS_H

#include <stdbool.h>
#include <stddef.h>

/* Writes the names joined by '|', e.g. "puncture:capsule|added"; empty if no bit is set. `membrane` is the name of the
   punctured membrane. The text is truncated to `size` bytes. */
void events_text(unsigned events, const char *membrane, char *text, size_t size);

/* Writes the names joined by ", ", e.g. "stale, ramping"; empty if no bit is set. */
void flags_text(unsigned flags, char *text, size_t size);

/* Writes the name of the flag with this index, counted from 0; returns false after the last flag. */
bool flag_at(int index, unsigned *bit, const char **word);

#endif
