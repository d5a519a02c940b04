/* Flags and events of a wrench in words: the names of their constants in lcmtypes/trocar.lcm, in lower case. */
#ifndef TROCAR_EVENTS_H
#define TROCAR_EVENTS_H

#include <stdbool.h>
#include <stddef.h>

/* Words joined by '|', e.g. "puncture:capsule|added"; empty for none. `membrane` names the punctured one. Text longer than `size`
   is cut. */
void events_text(unsigned events, const char *membrane, char *text, size_t size);

/* Words joined by ", ", e.g. "stale, ramping"; empty for none. */
void flags_text(unsigned flags, char *text, size_t size);

/* The flags one after the other, from index 0; false past the last. */
bool flag_at(int index, unsigned *bit, const char **word);

#endif
