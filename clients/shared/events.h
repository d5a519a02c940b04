/* Flags and events of a wrench as text: the names of their constants in lcmtypes/trocar.lcm, in lower case. */
#ifndef TROCAR_EVENTS_H
#define TROCAR_EVENTS_H

#include <stdbool.h>
#include <stddef.h>

/* Names joined by '|', e.g. "puncture:capsule|added"; empty for none. `membrane` is the punctured one's name. Text longer than
   `size` is truncated. */
void events_text(unsigned events, const char *membrane, char *text, size_t size);

/* Names joined by ", ", e.g. "stale, ramping"; empty for none. */
void flags_text(unsigned flags, char *text, size_t size);

/* Enumerates the flags by index from 0; false after the last. */
bool flag_at(int index, unsigned *bit, const char **word);

#endif
