/* Events of a tick in words. */
#ifndef TROCAR_EVENTS_H
#define TROCAR_EVENTS_H

#include <stddef.h>

/* TROCAR_EVENT_ bits as words joined by '|', e.g. "puncture:capsule|added"; empty for none. `membrane` names the one that was
   punctured. Text longer than `size` is cut off. */
void events_text(unsigned events, const char *membrane, char *text, size_t size);

#endif
